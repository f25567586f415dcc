"""Write frames/NAME.json: the sectors of a scan as polygons, in the structure of GeoJSON."""

import json
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_CLASS, NOT_TRAVERSABLE, ClassedSectors, SectorStack
from bumpymap.layers.scan.geometry import outlines
from bumpymap.layers.scan.style import SCAN_CLASS_NAMES, class_index

__all__ = ["write_polygons"]

_PLACE = (
    "metres in the frame of the sensor, x forward, y to the left; no longitude and latitude, so this is not a file of "
    "RFC 7946"
)


def write_polygons(name: str, classed: ClassedSectors, path: Path) -> None:
    """Write the sectors of the frame ``name`` in the order of the stack, with coordinates rounded to 1 mm."""
    stack = classed.sectors
    record = {
        "type": "FeatureCollection",
        "frame": name,
        "coordinates_in": _PLACE,
        "method": classed.method,
        "azimuth_start_rad": stack.azimuth_start_rad,
        "features": [
            {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}
            for properties, ring in zip(_properties(classed), _rings(stack), strict=True)
        ],
    }
    path.write_text(json.dumps(record, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def _rings(stack: SectorStack) -> Iterator[list[list[float]]]:
    """Yield the vertices of each sector; all are rounded and converted at once, which takes a tenth of the time."""
    found = outlines(stack)
    vertices = iter(np.round(np.concatenate([*found, np.empty((0, 2))]), 3).tolist())
    return (list(islice(vertices, len(outline))) for outline in found)


def _properties(classed: ClassedSectors) -> list[dict[str, Any]]:
    stack = classed.sectors
    count = len(stack.zone)
    columns: dict[str, list[Any]] = {
        "zone": stack.zone.tolist(),
        "ring": stack.ring.tolist(),
        "sector": stack.sector.tolist(),
        "points": stack.count.tolist(),
        "ground_points": stack.ground_count.tolist(),
        "class": [None if class_id == NOT_TRAVERSABLE else class_id for class_id in classed.class_id.tolist()],
        "class_name": [SCAN_CLASS_NAMES[place] for place in class_index(classed).tolist()],
        "traversable": stack.traversable.tolist(),
        "obstacle": stack.obstacle.tolist(),
        "obstacle_height": _numbers(stack.obstacle_height),
        "clearance": _numbers(stack.clearance),
        "stripes": [None] * count if classed.stripes is None else _numbers(classed.stripes),
        "normal": list(zip(*(_numbers(stack.normal[:, axis]) for axis in range(3)), strict=True)),
        "variance": _numbers(stack.variance),
        "residual": _numbers(stack.residual),
        "coverage": _numbers(stack.coverage),
        "label": [None if label < 0 else label for label in stack.label.tolist()],
    }
    if classed.ride is not None:
        columns |= {name: _numbers(getattr(classed.ride, name)) for name in ("c_r", "c_r_low", "c_r_high")}
        columns["ride_class"] = [None if value == NO_CLASS else value for value in classed.ride.class_id.tolist()]
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _numbers(values: NDArray[np.float32]) -> list[float | None]:
    """Round to the seven digits of a float32; what is not finite becomes None, since JSON has no NaN."""
    exact = values.astype(np.float64)
    known = np.isfinite(exact)
    with np.errstate(divide="ignore", invalid="ignore"):
        digits = 6 - np.floor(np.log10(np.abs(exact)))
    # Above 10^22 a power of ten is not exact; such numbers stay as they are.
    scaled = known & (exact != 0.0) & (np.abs(digits) <= 22)
    power = 10.0 ** np.abs(digits, where=scaled, out=np.zeros_like(exact))
    up = digits >= 0
    whole = np.rint(np.where(up, exact * power, exact / power))
    rounded = np.where(scaled, np.where(up, whole / power, whole * power), exact)
    return [value if ok else None for value, ok in zip(rounded.tolist(), known.tolist(), strict=True)]
