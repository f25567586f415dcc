from .folders import (
    in_sheets as in_sheets,
    remove_sheets as remove_sheets,
    sheet_folders as sheet_folders,
)
from .write import (
    SheetLayout as SheetLayout,
    SheetRun as SheetRun,
    made_names as made_names,
    require_whole as require_whole,
    suggested_sheets as suggested_sheets,
    write_sheets as write_sheets,
)
