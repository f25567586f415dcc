from .write import (
    EXPORT_FORMATS as EXPORT_FORMATS,
    Export as Export,
    ExportFormat as ExportFormat,
    ExportSettings as ExportSettings,
    Resolution as Resolution,
    export_map as export_map,
)
