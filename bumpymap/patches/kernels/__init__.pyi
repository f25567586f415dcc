from .measure import (
    MeasureSettings as MeasureSettings,
    PointsByTile as PointsByTile,
    TileMeasures as TileMeasures,
    measure_scratch as measure_scratch,
    measure_tiles as measure_tiles,
)
