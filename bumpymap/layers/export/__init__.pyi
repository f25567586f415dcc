from .settings import (
    ExportFormat as ExportFormat,
    ExportSettings as ExportSettings,
)
from .write import (
    Export as Export,
    export_map as export_map,
)
