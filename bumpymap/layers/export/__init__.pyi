from .write import (
    Export as Export,
    ExportSettings as ExportSettings,
    export_map as export_map,
)
