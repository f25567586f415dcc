from .report import (
    write_scan_report as write_scan_report,
)
from .run import (
    ScanFindings as ScanFindings,
    evaluate_scans as evaluate_scans,
    made_up as made_up,
    read_frames as read_frames,
)
from .settings import (
    ScanEvaluateSettings as ScanEvaluateSettings,
)
from .timing import (
    require_plain as require_plain,
)
