from .correction import (
    Correction as Correction,
    Prediction as Prediction,
    subtract_noise as subtract_noise,
)
from .fitting import (
    MOST_FAILED as MOST_FAILED,
    DrivenPatches as DrivenPatches,
    NoisyPatches as NoisyPatches,
    fit_correction as fit_correction,
)
from .geometry import (
    Rides as Rides,
    roll_over as roll_over,
)
from .noise import (
    CleanPatches as CleanPatches,
    denoise as denoise,
)
from .operator import (
    RideOperator as RideOperator,
)
from .rate import (
    RideModel as RideModel,
)
