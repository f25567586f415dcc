"""Write frames/NAME.json: the sectors of a scan as polygons, in the structure of GeoJSON."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import NOT_TRAVERSABLE, ClassedSectors
from bumpymap.layers.scan.geometry import outlines
from bumpymap.layers.scan.style import SCAN_CLASS_NAMES, style_index

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
            {
                "type": "Feature",
                "properties": properties,
                "geometry": {"type": "Polygon", "coordinates": [np.round(outline, 3).tolist()]},
            }
            for properties, outline in zip(_properties(classed), outlines(stack), strict=True)
        ],
    }
    path.write_text(json.dumps(record, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def _properties(classed: ClassedSectors) -> list[dict[str, Any]]:
    stack = classed.sectors
    count = len(stack.zone)
    stripes = [None] * count if classed.stripes is None else classed.stripes.tolist()
    styles = style_index(classed.class_id, np.arange(count, dtype=np.int32))
    columns: dict[str, list[Any]] = {
        "zone": stack.zone.tolist(),
        "ring": stack.ring.tolist(),
        "sector": stack.sector.tolist(),
        "points": stack.count.tolist(),
        "class": [None if class_id == NOT_TRAVERSABLE else class_id for class_id in classed.class_id.tolist()],
        "class_name": [SCAN_CLASS_NAMES[style] for style in styles],
        "traversable": stack.traversable.tolist(),
        "stripes": [_number(value) for value in stripes],
        "normal": [[_number(part) for part in normal] for normal in stack.normal.tolist()],
        "variance": [_number(value) for value in stack.variance.tolist()],
        "residual": [_number(value) for value in stack.residual.tolist()],
        "coverage": [_number(value) for value in stack.coverage.tolist()],
        "label": [None if label < 0 else label for label in stack.label.tolist()],
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _number(value: float | None) -> float | None:
    """Round to the seven digits of a float32; NaN becomes None, since JSON has no NaN."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.7g}")
