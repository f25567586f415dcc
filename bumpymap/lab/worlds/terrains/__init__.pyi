from .library import (
    FINE as FINE,
    KINDS as KINDS,
    Terrain as Terrain,
    make_terrain as make_terrain,
)
from .survey import (
    ScanEffects as ScanEffects,
    TerrainPoints as TerrainPoints,
    survey_terrain as survey_terrain,
)
