from .evidence import (
    DriveEvidence as DriveEvidence,
    LeftOut as LeftOut,
    collect_evidence as collect_evidence,
)
from .held_out import (
    HeldOutScore as HeldOutScore,
    hold_out as hold_out,
)
from .moved import (
    LogMove as LogMove,
    moved_calibration as moved_calibration,
)
from .posterior import (
    DrivePrior as DrivePrior,
    MovePosterior as MovePosterior,
    fit_move as fit_move,
    respond as respond,
)
