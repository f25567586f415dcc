from ._shapes import (
    fractal as fractal,
)
from .library import (
    make_terrain as make_terrain,
)
from .survey import (
    ScanEffects as ScanEffects,
    survey_terrain as survey_terrain,
)
