from .data import (
    UNSEEN as UNSEEN,
    scene_scan as scene_scan,
)
from .evaluate import (
    ScanEvaluation as ScanEvaluation,
)
from .make import (
    make_scan_model as make_scan_model,
)
from .train import (
    ScanTrainSettings as ScanTrainSettings,
)
