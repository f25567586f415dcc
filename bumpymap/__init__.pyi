from .api import (
    Layers as Layers,
    map_survey as map_survey,
    open_layers as open,  # noqa: A004 (as bumpymap.open)
)
from .change import diff_surveys as diff_surveys
from .check import check_drives as check_drives
from .core import (
    BadInputError as BadInputError,
    BumpymapError as BumpymapError,
    GroundGrid as GroundGrid,
    OutputError as OutputError,
    Route as Route,
    UsageError as UsageError,
)
from .rating import (
    Calibration as Calibration,
    Vehicle as Vehicle,
)
from .readers import points_of as points_of
from .route import (
    LineRide as LineRide,
    find_routes as find_routes,
    ride_along as ride_along,
)
from .scan import (
    ScanClassifier as ScanClassifier,
    ScanResult as ScanResult,
    classify_scan as classify_scan,
)
from .survey import map_batch as map_batch

__all__ = [
    "BadInputError",
    "BumpymapError",
    "Calibration",
    "GroundGrid",
    "Layers",
    "LineRide",
    "OutputError",
    "Route",
    "ScanClassifier",
    "ScanResult",
    "UsageError",
    "Vehicle",
    "__version__",
    "check_drives",
    "classify_scan",
    "diff_surveys",
    "find_routes",
    "map_batch",
    "map_survey",
    "open",
    "points_of",
    "ride_along",
]
__version__: str
