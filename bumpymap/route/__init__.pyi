from .ground import TileChoice as TileChoice, cost_of as cost_of
from .pipeline import (
    RouteResult as RouteResult,
    find_routes as find_routes,
    map_reach as map_reach,
    plan_routes as plan_routes,
)
from .places import (
    GridPoint as GridPoint,
    parse_point as parse_point,
    place_point as place_point,
)
from .planner import (
    Planner as Planner,
    plan_way as plan_way,
)
from .reach import (
    Reach as Reach,
)
from .search import (
    BETWEEN_OBSTACLES as BETWEEN_OBSTACLES,
    FROM_START as FROM_START,
    MOVES as MOVES,
    NOT_REACHED as NOT_REACHED,
    Way as Way,
    find_way as find_way,
    follow_back as follow_back,
    spread as spread,
)
from .settings import (
    CostSettings as CostSettings,
    RouteConfig as RouteConfig,
)
from .stops import NearestPoint as NearestPoint, nearest_usable as nearest_usable, usable_point as usable_point
from .straighten import (
    is_clear as is_clear,
    line_cost as line_cost,
    pull_tight as pull_tight,
    trace as trace,
)
