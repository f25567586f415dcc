from .drive import (
    DriveSettings as DriveSettings,
)
from .journal import (
    JobJournal as JobJournal,
    Journal as Journal,
    Key as Key,
)
from .motion import (
    MotionEffort as MotionEffort,
    motion_journal as motion_journal,
)
from .motion_fit import (
    add_motion as add_motion,
)
from .patch import (
    Effort as Effort,
    PatchDrives as PatchDrives,
)
from .plan import (
    CalibrationSettings as CalibrationSettings,
    library_terrain as library_terrain,
)
from .pool import (
    drive_jobs as drive_jobs,
)
from .relief import (
    ReliefGround as ReliefGround,
    fill_gaps as fill_gaps,
)
from .ride_fit import (
    relief_and_slope as relief_and_slope,
    survey_terrains as survey_terrains,
)
from .thin_surveys import (
    fit_thin_surveys as fit_thin_surveys,
)
from .validate import (
    DriveConditions as DriveConditions,
    drive_patches as drive_patches,
)
from .way import (
    WayDrive as WayDrive,
    drive_way as drive_way,
)
