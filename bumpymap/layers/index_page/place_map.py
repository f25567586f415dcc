"""A small map of where the surveys of a batch lie, as SVG: no background, only their extents and a scale."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from html import escape

from pyproj import Transformer
from pyproj.exceptions import ProjError

from bumpymap.core import count_text, stated_crs
from bumpymap.layers.batch_row import SurveyRow

__all__ = ["draw_places"]

_LEAST_WIDTH, _WIDTH, _MOST_HEIGHT, _EDGE = 260.0, 640.0, 280.0, 24.0
_DEGREE_M = 111_320.0
_LEAST_M = 100.0
_SMALLEST_PX = 7.0
_SCALES = (1, 2, 5)


@dataclass(frozen=True, slots=True)
class _Placed:
    """Extent of a survey in WGS 84, degrees."""

    row: SurveyRow
    west: float
    south: float
    east: float
    north: float


def draw_places(rows: Sequence[SurveyRow], kinds: Sequence[str], labels: Sequence[str]) -> str:
    """Return the map as SVG; empty if fewer than two surveys have a known place, or they lie all over the Earth.

    Parameters
    ----------
    rows : sequence of SurveyRow
    kinds : sequence of str
        CSS class of each.
    labels : sequence of str
        Name of each, as text.
    """
    found = [(box, kind, label) for row, kind, label in zip(rows, kinds, labels, strict=True) if (box := _box(row))]
    if len(found) < 2:
        return ""
    west, south = min(box.west for box, _, _ in found), min(box.south for box, _, _ in found)
    east, north = max(box.east for box, _, _ in found), max(box.north for box, _, _ in found)
    middle = math.radians((south + north) / 2)
    if east - west > 180 or max(abs(south), abs(north)) > 85:
        return ""
    per_degree = _DEGREE_M * math.cos(middle), _DEGREE_M
    wide, high = max((east - west) * per_degree[0], _LEAST_M), max((north - south) * per_degree[1], _LEAST_M)
    scale = min((_WIDTH - 2 * _EDGE) / wide, (_MOST_HEIGHT - 2 * _EDGE) / high)
    width, height = max(wide * scale + 2 * _EDGE, _LEAST_WIDTH), high * scale + 2 * _EDGE + 16

    def place(box: _Placed) -> tuple[float, float, float, float]:
        left, top = _EDGE + (box.west - west) * per_degree[0] * scale, _EDGE + (north - box.north) * _DEGREE_M * scale
        size = (box.east - box.west) * per_degree[0] * scale, (box.north - box.south) * _DEGREE_M * scale
        grown = [max(side, _SMALLEST_PX) for side in size]
        return left - (grown[0] - size[0]) / 2, top - (grown[1] - size[1]) / 2, grown[0], grown[1]

    shapes = []
    for box, kind, label in found:
        x, y, w, h = place(box)
        shapes.append(
            f'<rect class="{kind}" x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}"><title>{escape(label)}'
            "</title></rect>"
        )
    missing = len(rows) - len(found)
    lying = count_text(len(found), "survey lies", "surveys lie")
    about = f"Where {lying}, north up, {west:.4f} to {east:.4f} east, {south:.4f} to {north:.4f} north"
    beside = f" {missing} without a known place are not drawn." if missing else ""
    return (
        f'<figure><svg class="places" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" role="img" '
        f'aria-label="{about}">'
        f"{''.join(shapes)}{_scale_bar(scale, height)}</svg>"
        f"<figcaption>Where the surveys lie, north up; small ones are drawn larger.{beside}</figcaption></figure>"
    )


def _scale_bar(scale: float, height: float) -> str:
    """Return a bar of a round length, at most a quarter of the width."""
    most = _WIDTH / 4 / scale
    power = 10 ** math.floor(math.log10(most))
    length = max(step * power for step in _SCALES if step * power <= most)
    text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    y = height - 12
    return (
        f'<path class="scale" d="M{_EDGE} {y - 5:.1f}v5h{length * scale:.1f}v-5"/>'
        f'<text x="{_EDGE + length * scale + 6:.1f}" y="{y:.1f}">{text}</text>'
    )


def _box(row: SurveyRow) -> _Placed | None:
    left, bottom, right, top = row.min_x, row.min_y, row.max_x, row.max_y
    if row.crs is None or left is None or bottom is None or right is None or top is None:
        return None
    transformer = _to_degrees(row.crs)
    if transformer is None:
        return None
    try:
        west, south, east, north = transformer.transform_bounds(left, bottom, right, top)
    except ProjError:
        return None
    if not all(map(math.isfinite, (west, south, east, north))) or west > east:
        return None
    return _Placed(row, west, south, east, north)


@cache
def _to_degrees(crs: str) -> Transformer | None:
    try:
        return Transformer.from_crs(stated_crs(crs), "EPSG:4326", always_xy=True)
    except ProjError:
        return None
