"""Write what can be reached: reach.tif and isochrones.geojson."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
import shapely.geometry
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Band
from bumpymap.layers._cog import write_array
from bumpymap.layers._imports import import_notebook
from bumpymap.layers.placement import Placement, RasterSpec
from bumpymap.layers.regions import label, trace_all
from bumpymap.layers.vector import GeoJsonCoordinates, feature, write_features

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, slots=True)
class ReachField:
    """Cost of reaching the tiles of a window from one start. Arrays are (rows, cols), north row first."""

    placement: Placement
    """The raster that the window spans."""
    cost: NDArray[np.float32]
    """Cost of the cheapest way to the middle of the tile, m; NaN where none leads (so are the minutes)."""
    minutes: NDArray[np.float32]
    """Time along that way at the speed made good, min."""


def write_reach(reach: ReachField, path: Path, about: Mapping[str, str] | None = None) -> None:
    """Write reach.tif: a float32 COG, one pixel per tile, bands ``cost`` (m) and ``minutes``.

    ``about``: metadata of the file, such as the vehicle and the start. Raises OutputError: the file cannot be written.
    """
    bands = [
        Band("cost", "m", "cost of the cheapest way from the start: its length and the detours it is worth"),
        Band("minutes", "min", "time along the cheapest way at the speed made good"),
    ]
    spec = RasterSpec(
        bands=bands,
        crs=reach.placement.horizontal_crs,
        tags={"title": "cost of the cheapest way to each tile"} | dict(about or {}),
    )
    write_array(path, reach.placement, spec, np.stack([reach.cost, reach.minutes]).astype(np.float32, copy=False))


def write_isochrones(
    reach: ReachField, levels: Sequence[float], path: Path, *, about: Mapping[str, Any] | None = None
) -> None:
    """Write one multipolygon for each level: all tiles that can be reached within it, so the larger hold the smaller.

    RFC 7946 in WGS 84, or the survey's own coordinates without a CRS. The largest level comes first: a GIS then draws
    the smaller ones over it. Outlines run along the sides of tiles. A level within which no tile can be reached has a
    null geometry.

    ``levels``: positive, minutes; ``about``: further members of the collection, such as vehicle and start. Raises
    OutputError: the file cannot be written; BadInputError: a level is not a positive number.
    """
    wanted = sorted({float(level) for level in levels}, reverse=True)
    if not wanted or not (np.isfinite(wanted).all() and wanted[-1] > 0):
        raise BadInputError(f"the levels are {list(levels)}. Give positive numbers of minutes, at least one")
    place = GeoJsonCoordinates.of(reach.placement, local=True)
    features = []
    for level in wanted:
        inside = reach.minutes <= level  # NaN is never inside
        geometry = None
        if inside.any():
            # Tiles that touch at a corner only are polygons apart: nothing drives over a corner.
            labels, first = label(inside.astype(np.uint8))
            polygons = place.polygons(trace_all(labels, reach.placement.window, len(first)))
            geometry = shapely.multipolygons(shapely.get_parts(polygons))
        area = int(inside.sum()) * reach.placement.grid.tile_size**2
        features.append(feature({"within": level, "of": "minutes", "unit": "min", "area_m2": area}, geometry))
    write_features(path, "isochrones", place, features, about)


def reach_dataset(reach: ReachField) -> "xarray.Dataset":
    """Return cost and minutes of a reach on the grid of tiles, dimensions ``y`` (north first) and ``x``.

    Raises UsageError: the extra ``notebook`` is not installed.
    """
    xarray = import_notebook("xarray")
    import_notebook("rioxarray")
    place, window = reach.placement, reach.placement.window
    x = place.to_crs(window.col + 0.5 + np.arange(window.cols))
    y = place.to_crs(window.row + window.rows - 0.5 - np.arange(window.rows))
    variables = {
        "cost": (("y", "x"), reach.cost, {"units": "m", "long_name": "cost of the cheapest way"}),
        "minutes": (("y", "x"), reach.minutes, {"units": "min", "long_name": "time along the cheapest way"}),
    }
    dataset = xarray.Dataset(variables, {"y": y, "x": x})
    return dataset if place.horizontal_crs is None else dataset.rio.write_crs(place.horizontal_crs.to_wkt())
