from .survey import (
    WoodPoints as WoodPoints,
    survey_wood as survey_wood,
)
from .sweep import (
    swept_tiles as swept_tiles,
    true_pixels as true_pixels,
)
from .wood import (
    Wood as Wood,
    plant_wood as plant_wood,
)
