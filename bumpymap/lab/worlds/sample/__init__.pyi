from ._noise import (
    BlockLayer as BlockLayer,
    WaveField as WaveField,
    smooth_step as smooth_step,
    uniform as uniform,
)
from .files import (
    make_quarry_survey as make_quarry_survey,
)
