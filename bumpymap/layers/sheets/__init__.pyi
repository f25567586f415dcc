from .finished import (
    made_names as made_names,
    require_whole as require_whole,
)
from .folders import (
    in_sheets as in_sheets,
    remove_sheets as remove_sheets,
    sheet_folders as sheet_folders,
)
from .layout import (
    SheetLayout as SheetLayout,
    suggested_sheets as suggested_sheets,
)
from .write import (
    SheetRun as SheetRun,
    write_sheets as write_sheets,
)
