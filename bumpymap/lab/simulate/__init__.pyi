from .calibrate import (
    calibrate_vehicle as calibrate_vehicle,
)
from .checks import (
    all_checks as all_checks,
)
from .drive import (
    DriveSettings as DriveSettings,
)
from .journal import (
    Journal as Journal,
    Key as Key,
)
from .library import (
    library_terrains as library_terrains,
)
from .model import (
    Physics as Physics,
    require_dart as require_dart,
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
    fit_ride as fit_ride,
    relief_of as relief_of,
    surveyed as surveyed,
)
from .terrain import (
    PatchGround as PatchGround,
)
from .validate import (
    drive_patches as drive_patches,
)
