from .read import (
    read_scan as read_scan,
)
