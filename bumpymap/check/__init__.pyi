from .measure import (
    LEFT_OUT as LEFT_OUT,
    DriveMeasure as DriveMeasure,
    WayStretch as WayStretch,
    measure_drive as measure_drive,
)
from .pipeline import (
    CheckRun as CheckRun,
    agreement_of as agreement_of,
    check_drives as check_drives,
    run_check as run_check,
)
from .places import (
    MetrePlaces as MetrePlaces,
    local_metres as local_metres,
    metre_places as metre_places,
)
from .settings import (
    CheckConfig as CheckConfig,
    ReadingSettings as ReadingSettings,
)
from .stretches import (
    cut_stretches as cut_stretches,
)
