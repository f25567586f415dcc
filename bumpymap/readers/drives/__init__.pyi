from .columns import parse_columns as parse_columns
from .read import (
    read_drive as read_drive,
)
