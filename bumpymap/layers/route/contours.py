"""Write isochrones.geojson: the ground that can be reached within given costs or minutes."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import shapely.geometry
from numpy.typing import NDArray

from bumpymap.core import BadInputError, atomic
from bumpymap.layers._label import label
from bumpymap.layers.lonlat import BoundingBox
from bumpymap.layers.outlines import trace_labels
from bumpymap.layers.route.reach_raster import ReachField
from bumpymap.layers.vector import GeoJsonCoordinates

__all__ = ["reach_polygons", "write_isochrones"]

_UNITS = {"cost": "m", "minutes": "min"}


def write_isochrones(
    reach: ReachField, levels: Sequence[float], path: Path, *, by: str, about: Mapping[str, Any] | None = None
) -> None:
    """Write one multipolygon for each level: all tiles that can be reached within it, so the larger hold the smaller.

    RFC 7946 in WGS 84, or the survey's own coordinates without a CRS. The largest level comes first: a GIS then draws
    the smaller ones over it. Outlines run along the sides of tiles. A level within which no tile can be reached has a
    null geometry.

    Parameters
    ----------
    reach : ReachField
    levels : sequence of float
        Positive; m of cost, or minutes.
    path : Path
        The file, which appears only when it is complete.
    by : str
        ``cost`` or ``minutes``.
    about : mapping, optional
        Further members of the collection, such as vehicle and start.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        A level is not a positive number, or the reach has no minutes.
    """
    values = reach.cost if by == "cost" else reach.minutes
    if values is None:
        raise BadInputError("this reach has no minutes. Give the levels as cost, in m")
    wanted = sorted({float(level) for level in levels}, reverse=True)
    if not wanted or not (np.isfinite(wanted).all() and wanted[-1] > 0):
        raise BadInputError(f"the levels are {list(levels)}. Give positive numbers of {_UNITS[by]}, at least one")
    place = GeoJsonCoordinates.of(reach.placement, local=True)
    box = BoundingBox()
    features = list(_features(reach, values, wanted, place, box, by))
    found = any(feature["geometry"] for feature in features)
    collection = {
        "type": "FeatureCollection",
        "name": "isochrones",
        **place.members,
        **(about or {}),
        **({"bbox": place.bounds(box)} if found else {}),
        "features": features,
    }
    text = json.dumps(collection, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    with atomic(path) as temporary:
        temporary.write_bytes(f"{text}\n".encode("utf-8", "backslashreplace"))


def _features(
    reach: ReachField,
    values: NDArray[np.float32],
    levels: Sequence[float],
    place: GeoJsonCoordinates,
    box: BoundingBox,
    by: str,
) -> Iterator[dict[str, Any]]:
    for level in levels:
        inside = values <= level  # NaN is never inside
        geometry = None
        if inside.any():
            polygons = place.polygons(reach_polygons(reach, inside))
            box.add(polygons)
            geometry = shapely.geometry.mapping(shapely.multipolygons(shapely.get_parts(polygons)))
        tiles = int(inside.sum())
        properties = {"within": level, "of": by, "unit": _UNITS[by], "area_m2": tiles * reach.grid.tile_size**2}
        yield {"type": "Feature", "properties": properties, "geometry": geometry}


def reach_polygons(reach: ReachField, inside: NDArray[np.bool_]) -> NDArray[np.object_]:
    """Return the outlines of the tiles that are inside, (m,) valid polygons in grid coordinates (1 is one tile).

    Tiles that touch at a corner only are polygons apart: nothing drives over a corner.
    """
    labels, first, _ = label(inside.astype(np.uint8))
    return trace_labels(labels, reach.window, slice(0, reach.window.rows), range(1, len(first) + 1))
