from .ground import points_along as points_along
from .line_ride import (
    LineRide as LineRide,
    LineVehicle as LineVehicle,
    line_vehicle as line_vehicle,
    ride_along as ride_along,
    ride_line as ride_line,
)
from .pipeline import (
    RouteResult as RouteResult,
    find_routes as find_routes,
    plan_routes as plan_routes,
)
from .places import extent_text as extent_text, parse_point as parse_point
from .settings import CostSettings as CostSettings, RouteConfig as RouteConfig
