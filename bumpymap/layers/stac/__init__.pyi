from .catalog import (
    write_catalog as write_catalog,
)
from .item import (
    write_item as write_item,
)
