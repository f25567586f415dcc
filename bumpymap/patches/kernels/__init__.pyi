from .measure import (
    MeasureSettings as MeasureSettings,
    PointsByTile as PointsByTile,
    TileMeasures as TileMeasures,
    measure_scratch as measure_scratch,
    measure_tiles as measure_tiles,
)
from .objects import (
    ObjectLimits as ObjectLimits,
    TileObjects as TileObjects,
    find_in_tiles as find_in_tiles,
    object_scratch as object_scratch,
)
from .solids import (
    settle_solids as settle_solids,
    solid_scratch as solid_scratch,
)
from .standing import (
    PAIR_MEASURES as PAIR_MEASURES,
    PairSettings as PairSettings,
    StandingLimits as StandingLimits,
    mark_standing as mark_standing,
    measure_pairs as measure_pairs,
    pair_scratch as pair_scratch,
    standing_scratch as standing_scratch,
)
