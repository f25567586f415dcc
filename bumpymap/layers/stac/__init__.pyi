from .item import (
    write_catalog as write_catalog,
    write_item as write_item,
)
