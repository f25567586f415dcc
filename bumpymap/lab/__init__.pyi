from .evaluate import (
    REPORT as REPORT,
    ScanFindings as ScanFindings,
    evaluate_scans as evaluate_scans,
    labels_of as labels_of,
    percent as percent,
    write_scan_report as write_scan_report,
)
from .label_sets import LABEL_SETS as LABEL_SETS
from .settings import (
    CalibrationSettings as CalibrationSettings,
    NetworkSettings as NetworkSettings,
    ScanEvaluateSettings as ScanEvaluateSettings,
    ScanTrainSettings as ScanTrainSettings,
    TrainSettings as TrainSettings,
)
from .simulate.calibrate import (
    calibrate_vehicle as calibrate_vehicle,
    calibration_jobs as calibration_jobs,
    calibration_journal as calibration_journal,
    seconds_of_drives as seconds_of_drives,
)
from .simulate.drive import library_terrains as library_terrains
from .simulate.model import require_dart as require_dart
from .train.model_files import EpochReport as EpochReport
from .train.scan_net import make_scan_model as make_scan_model
from .train.textures import make_model as make_model
