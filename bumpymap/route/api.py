"""Routes from Python: from layers to ways, or to what can be reached, in one call."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from bumpymap.core import UsageError
from bumpymap.layers import Layers, PlannedRoute, reach_dataset
from bumpymap.route.pipeline import plan_routes, reach_from
from bumpymap.route.settings import CostSettings, RouteConfig

if TYPE_CHECKING:
    import xarray

__all__ = ["find_routes", "map_reach"]

PathLike: TypeAlias = str | os.PathLike[str]
Point: TypeAlias = str | tuple[float, float]
"""``"lon,lat"`` or ``"x,y"`` in the survey's CRS, or a pair of such numbers."""
_OF_COST = ("risk", "robust", "unknown", "avoid", "only", "allow_outside")


def find_routes(
    layers: "PathLike | Layers | Iterable[PathLike]",
    start: Point,
    goal: Point,
    *,
    via: Iterable[Point] = (),
    out: PathLike | None = None,
    **settings: Any,
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
        metre], ``snap`` [m], ``visit``, ``round_trip``, ``avoid``, ``only``, ``allow_outside``, ``compare``,
        ``memory``, ``overwrite``.

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
    config = _config(layers, settings, start=_text(start), goal=_text(goal), via=tuple(map(_text, via)), out=_path(out))
    return list(plan_routes(config).routes)


def map_reach(
    layers: "PathLike | Layers | Iterable[PathLike]", start: Point, *, minutes: float | None = None, **settings: Any
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
    limit = () if minutes is None else (float(minutes),)
    config = _config(layers, settings, start=_text(start), isochrones=limit)
    return reach_dataset(reach_from(config))


def _config(layers: "PathLike | Layers | Iterable[PathLike]", settings: dict[str, Any], **own: Any) -> RouteConfig:
    """Build the settings of a call."""
    allowed = {*RouteConfig.__dataclass_fields__, *_OF_COST} - {"cost", "layers", *own}
    wrong = sorted(set(settings) - allowed)
    if wrong:
        raise UsageError(f"there is no setting {wrong[0]!r}; the settings are {', '.join(sorted(allowed))}")
    given = dict(settings)
    for name in ("avoid", "only", "points"):
        if given.get(name) is not None:
            given[name] = Path(given[name])
    if "compare" in given:
        given["compare"] = tuple(map(Path, given["compare"]))
    cost = CostSettings(**{name: given.pop(name) for name in _OF_COST if name in given})
    return RouteConfig(layers=_folders(layers), cost=cost, **given, **own)


def _folders(layers: "PathLike | Layers | Iterable[PathLike]") -> tuple[Path, ...]:
    if isinstance(layers, Layers):
        return (layers.folder,)
    if isinstance(layers, str | os.PathLike):
        return (Path(layers),)
    return tuple(map(Path, layers))


def _path(path: PathLike | None) -> Path | None:
    return None if path is None else Path(path)


def _text(point: Point) -> str:
    return point if isinstance(point, str) else ",".join(repr(float(value)) for value in point)
