from .calibration import (
    Calibration as Calibration,
    DrivenTerrain as DrivenTerrain,
)
from .calibration_lookup import (
    find_calibration as find_calibration,
)
from .class_kernels import (
    CostRules as CostRules,
    CostTables as CostTables,
    RatedTiles as RatedTiles,
    TilesToRate as TilesToRate,
    rate_tiles as rate_tiles,
)
from .cost import (
    rate as rate,
    rate_as_paper as rate_as_paper,
)
from .ride.correction import (
    Correction as Correction,
    Prediction as Prediction,
    above_noise as above_noise,
)
from .ride.fitting import (
    MOST_FAILED as MOST_FAILED,
    DrivenPatches as DrivenPatches,
    NoisyPatches as NoisyPatches,
    fit_correction as fit_correction,
)
from .ride.geometry import (
    Rides as Rides,
    roll_over as roll_over,
)
from .ride.noise import (
    CleanPatches as CleanPatches,
    denoise as denoise,
)
from .ride.operator import (
    RideOperator as RideOperator,
)
from .ride.rate import (
    RideModel as RideModel,
)
from .texture_network import (
    TextureModel as TextureModel,
    classify as classify,
)
from .textures import (
    FEATURE_VERSION as FEATURE_VERSION,
    make_short_waves as make_short_waves,
    make_textures as make_textures,
    normalise as normalise,
    remove_plane as remove_plane,
)
from .vehicle.blank import (
    write_blank as write_blank,
)
from .vehicle.profile import (
    VehicleProfile as VehicleProfile,
    load_profile as load_profile,
    shipped_profiles as shipped_profiles,
)
