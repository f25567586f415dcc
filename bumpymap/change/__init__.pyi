from .compare import (
    CommonError as CommonError,
    GroundChange as GroundChange,
    coarsen as coarsen,
    compare_heights as compare_heights,
    hold_false_discoveries as hold_false_discoveries,
    ride_z as ride_z,
    two_sided as two_sided,
    upper_sided as upper_sided,
    widening as widening,
)
from .pipeline import (
    ChangeResult as ChangeResult,
    diff_surveys as diff_surveys,
    find_changes as find_changes,
)
from .settings import (
    DiffConfig as DiffConfig,
)
