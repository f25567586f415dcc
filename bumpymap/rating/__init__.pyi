from .calibration import (
    Calibration as Calibration,
    DrivenTerrain as DrivenTerrain,
    find_calibration as find_calibration,
    shipped_calibrations as shipped_calibrations,
)
from .drive_update import (
    DriveUpdate as DriveUpdate,
    update_from_drives as update_from_drives,
)
from .passable import (
    ZoneFinder as ZoneFinder,
    close_split_tiles as close_split_tiles,
    find_passable as find_passable,
    free_areas as free_areas,
    settle_objects as settle_objects,
)
from .ride.correction import (
    TAIL as TAIL,
    Correction as Correction,
    fail_features as fail_features,
    ride_features as ride_features,
    subtract_noise as subtract_noise,
)
from .ride.operator import (
    MotionOperator as MotionOperator,
    RideOperator as RideOperator,
    Rides as Rides,
    chassis_response as chassis_response,
    felt_response as felt_response,
    heave_filter as heave_filter,
    move_over as move_over,
    roll_over as roll_over,
    wheel_turn as wheel_turn,
)
from .ride.rate import (
    DRIVE_LOG_SD as DRIVE_LOG_SD,
    RideModel as RideModel,
    denoise as denoise,
    felt_along as felt_along,
    match_noise as match_noise,
    remove_plane as remove_plane,
    roll_wheels as roll_wheels,
    smooth_over as smooth_over,
)
from .ride.speed import (
    QUANTITIES as QUANTITIES,
    MotionFit as MotionFit,
    MotionModel as MotionModel,
    at_speed as at_speed,
    map_calibration as map_calibration,
    map_rule as map_rule,
    motion_factors as motion_factors,
    motion_felt as motion_felt,
    motion_terms as motion_terms,
    plain_terms as plain_terms,
)
from .ride.thin import (
    THIN_COLUMNS as THIN_COLUMNS,
    THIN_RING as THIN_RING,
    BlockRating as BlockRating,
    Strength as Strength,
    ThinModel as ThinModel,
    dense_share as dense_share,
    find_strengths as find_strengths,
    is_rateable as is_rateable,
    log_points as log_points,
    rate_thin as rate_thin,
    thin_columns as thin_columns,
    thin_terms as thin_terms,
)
from .steps import (
    TileSteps as TileSteps,
    apply_steps as apply_steps,
    closing_height as closing_height,
    edge_usable as edge_usable,
    find_steps as find_steps,
    rate_beside_steps as rate_beside_steps,
)
from .textures import (
    FEATURE_VERSION as FEATURE_VERSION,
    MEASURES as MEASURES,
    TextureModel as TextureModel,
    classify as classify,
    measures_of as measures_of,
    normalise as normalise,
    rate as rate,
    rate_as_paper as rate_as_paper,
)
from .vehicle_profile import (
    KEYS as KEYS,
    Vehicle as Vehicle,
    estimated_values as estimated_values,
    flat_profile as flat_profile,
    less_floor as less_floor,
    shipped_profiles as shipped_profiles,
    with_floor as with_floor,
    write_profile_template as write_profile_template,
)
