from .api import (
    diff_surveys as diff_surveys,
)
from .discovery import (
    hold_false_discoveries as hold_false_discoveries,
    two_sided as two_sided,
    upper_sided as upper_sided,
    widening as widening,
)
from .ground import (
    GroundChange as GroundChange,
    coarsen as coarsen,
    compare_heights as compare_heights,
)
from .pipeline import (
    ChangeResult as ChangeResult,
    find_changes as find_changes,
)
from .ride import (
    CommonError as CommonError,
    ride_z as ride_z,
)
from .settings import (
    DiffConfig as DiffConfig,
)
