from .drive import (
    DriveSettings as DriveSettings,
)
from .journal import (
    Journal as Journal,
    Key as Key,
)
from .patch import (
    Effort as Effort,
    PatchDrives as PatchDrives,
)
from .plan import (
    CalibrationSettings as CalibrationSettings,
    library_terrain as library_terrain,
)
from .ride_fit import (
    relief_of as relief_of,
    surveyed as surveyed,
)
from .validate import (
    DriveConditions as DriveConditions,
    drive_patches as drive_patches,
)
