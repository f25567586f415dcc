"""Routes from Python: from layers to ways, or to what can be reached, in one call."""

import os
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict, Unpack

from bumpymap.core import UsageError, path_of_call, refuse_unknown, settings_of_call, short_repr
from bumpymap.layers import Layers, PlannedRoute, folder_of, reach_dataset
from bumpymap.route.pipeline import plan_routes, reach_from
from bumpymap.route.settings import CostSettings, RouteConfig

if TYPE_CHECKING:
    import xarray

__all__ = ["find_routes", "map_reach"]

PathLike: TypeAlias = str | os.PathLike[str]
Point: TypeAlias = str | tuple[float, float]
"""``"lon,lat"`` or ``"x,y"`` in the survey's CRS, or a pair of such numbers."""


class ReachSettings(TypedDict, total=False):
    """Settings of `map_reach`: fields of ``RouteConfig`` and ``CostSettings``; paths may be strings."""

    risk: float | None
    robust: bool
    unknown: float | None
    snap: float
    avoid: PathLike | None
    only: PathLike | None
    allow_outside: bool
    memory: str


class RouteSettings(ReachSettings, total=False):
    """Settings of `find_routes`."""

    alternatives: int
    through_obstacles: bool
    visit: bool
    round_trip: bool
    compare: Iterable[PathLike]
    overwrite: bool


def find_routes(
    layers: "PathLike | Layers | Iterable[PathLike]",
    start: Point,
    goal: Point,
    *,
    via: Iterable[Point] = (),
    out: PathLike | None = None,
    **settings: Unpack[RouteSettings],
) -> list[PlannedRoute]:
    """Find the cheapest way over mapped ground, and alternatives.

    Parameters
    ----------
    layers : path, Layers, or several paths
        What `map_survey` or ``bumpymap map`` wrote; several folders are sheets of one map.
    start, goal : str or (float, float)
        Longitude and latitude, or coordinates in the survey's CRS: what lies on the map decides.
    via : points, optional
        Points to pass on the way.
    out : path, optional
        Folder, or file that ends in .geojson, .gpx, .csv or .png.
    **settings
        Those of ``bumpymap route``, with underscores: ``alternatives``, ``risk`` [m], ``robust``, ``unknown`` [cost per
        metre], ``snap`` [m], ``visit``, ``round_trip``, ``avoid``, ``only``, ``allow_outside``,
        ``through_obstacles``, ``compare``, ``memory``, ``overwrite``.

    Returns
    -------
    list of PlannedRoute
        The best one first.

    Raises
    ------
    BadInputError
        The layers cannot be read, a point does not lie on ground that can be used, or there is no way.
    UsageError
        A setting is unknown or wrong.
    OutputError
        A file cannot be written.

    Examples
    --------
    >>> import bumpymap
    >>> best, *others = bumpymap.find_routes("site_layers", (512350.5, 5403300.5), (512450.5, 5403300.5))
    >>> round(best.figures.length_m / best.figures.straight_m, 1) >= 1.0
    True
    """
    if isinstance(via, str) or not isinstance(via, Iterable):
        raise UsageError(f"via is {short_repr(via)}; give a list of points, such as [(512350.5, 5403300.5)]")
    own = _settings(settings, "find_routes", RouteSettings.__annotations__)
    own |= {"start": _text("start", start), "goal": _text("goal", goal), "via": tuple(_text("via", p) for p in via)}
    target = None if out is None else Path(path_of_call("out", out))
    config = RouteConfig(layers=_folders(layers), out=target, **own)
    return list(plan_routes(config).routes)


def map_reach(
    layers: "PathLike | Layers | Iterable[PathLike]",
    start: Point,
    *,
    minutes: float | None = None,
    **settings: Unpack[ReachSettings],
) -> "xarray.Dataset":
    """Map what can be reached from a point: cost and minutes of the cheapest way to every tile.

    Parameters
    ----------
    layers, start
        As in `find_routes`.
    minutes : float, optional
        Tiles farther away than this are left out where possible, so that less is read.
    **settings
        ``risk``, ``robust``, ``unknown``, ``snap``, ``avoid``, ``only``, ``allow_outside``, ``memory``, as in
        `find_routes`.

    Returns
    -------
    xarray.Dataset
        ``cost`` [m] and ``minutes`` [min], NaN where a tile cannot be reached; dimensions ``y`` (north first), ``x``.

    Raises
    ------
    BadInputError, UsageError
        As `find_routes`; or the extra ``notebook`` is not installed.
    """
    own = _settings(settings, "map_reach", ReachSettings.__annotations__)
    own |= settings_of_call({"isochrones": None if minutes is None else [minutes]}, RouteConfig, "map_reach")
    config = RouteConfig(layers=_folders(layers), start=_text("start", start), **own)
    return reach_dataset(reach_from(config))


def _settings(settings: Mapping[str, Any], function: str, known: Collection[str]) -> dict[str, Any]:
    """Check the settings of a call; those of the cost become one."""
    refuse_unknown(settings, known, function)
    of_cost = {name: value for name, value in settings.items() if name in CostSettings.__dataclass_fields__}
    others = {name: value for name, value in settings.items() if name not in of_cost}
    cost = CostSettings(**settings_of_call(of_cost, CostSettings, function))
    return {**settings_of_call(others, RouteConfig, function), "cost": cost}


def _folders(layers: "PathLike | Layers | Iterable[PathLike]") -> tuple[Path, ...]:
    if isinstance(layers, Layers | str | os.PathLike) or not isinstance(layers, Iterable):
        return (folder_of("layers", layers),)
    return tuple(folder_of("layers", each) for each in layers)


def _text(name: str, point: Point) -> str:
    if isinstance(point, str):
        return point
    try:
        x, y = (float(value) for value in point)
    except (TypeError, ValueError) as error:
        raise UsageError(
            f"{name} is {short_repr(point)}; give a pair of numbers, such as (512350.5, 5403300.5), or 'LON,LAT'"
        ) from error
    return f"{x!r},{y!r}"
