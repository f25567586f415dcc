from .cost_field import (
    TileChoice as TileChoice,
    cost_of as cost_of,
    load_cost as load_cost,
)
from .places import (
    GridPoint as GridPoint,
    parse_point as parse_point,
    place_point as place_point,
)
from .snap import (
    NearestPoint as NearestPoint,
    nearest_usable as nearest_usable,
    usable_point as usable_point,
)
