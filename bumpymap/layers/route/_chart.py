"""The profile under the map: height and ride cost along a way."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import RouteProfile
from bumpymap.layers.ride_scale import RideScale
from bumpymap.layers.route._pen import Pen, ticks
from bumpymap.layers.route._relief import UNKNOWN_SHADE, Pixels

__all__ = ["FAINT", "INK", "draw_profile"]

INK, FAINT, GRID, INTERVAL = (28, 30, 34), (92, 96, 104), (226, 228, 232), (196, 200, 208)
_LEAST_RELIEF_M = 2.0
"""Least span of the height axis, m: a level way must not look like mountains."""
_LEAST_LENGTH_M = 1.0
"""Least length of the axis of distance, m: a way of length 0 has none."""
_FILL = 0.75


@dataclass(frozen=True, slots=True)
class _Axes:
    """A rectangle of the picture, pixels, and the values at its sides."""

    left: int
    top: int
    width: int
    height: int
    far: float
    """Distance at the right side, m."""
    low: float
    """Value at the lower side."""
    high: float
    """Value at the upper side."""

    def points(self, distance: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where points of a curve lie, (n, 2) pixels right and down."""
        return np.column_stack([self.left + distance / self.far * self.width, self.rows(values)])

    @property
    def distances(self) -> NDArray[np.float64]:
        """(width,) distance in the middle of each column of pixels, m."""
        return (np.arange(self.width) + 0.5) / self.width * self.far

    def rows(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return pixels down the picture of values."""
        share = np.clip((values - self.low) / (self.high - self.low), 0.0, 1.0)
        return np.asarray(self.top + (1.0 - share) * self.height, dtype=np.float64)


def draw_profile(pen: Pen, profile: RouteProfile, box: tuple[int, int, int, int], scale: RideScale) -> None:
    """Draw height over distance, filled with the colours of the ride cost, and the ride cost with its interval.

    Parameters
    ----------
    pen : Pen
    profile : RouteProfile
    box : tuple
        Left, top, width and height of the drawing without its labels, pixels; they need 80 to the left, 50 below.
    scale : RideScale
        The colours of the ride cost.
    """
    left, top, width, height = box
    split = round(height * 0.6)
    far = max(float(profile.distance[-1]), _LEAST_LENGTH_M)
    known = profile.z[np.isfinite(profile.z)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, _LEAST_RELIEF_M)
    room = max(high - low, _LEAST_RELIEF_M) * 0.12
    middle, half = (low + high) / 2, max(high - low, _LEAST_RELIEF_M) / 2
    ground = _Axes(left, top, width, split, far, middle - half - room, middle + half + room)
    ends = profile.c_r_high[np.isfinite(profile.c_r_high)]
    most = max(scale.end, float(np.quantile(ends, 0.98))) if len(ends) else scale.end
    ride = _Axes(left, top + split + 14, width, height - split - 14, far, 0.0, most * 1.05)
    _fill_ground(pen, ground, profile, scale)
    _frame(pen, ground, "height [m]", 4)
    _curve(pen, ground, profile.distance, profile.z)
    nearest = _nearest(profile.distance, ride.distances)
    _fill_interval(pen, ride, profile.c_r_low[nearest], profile.c_r_high[nearest])
    _frame(pen, ride, "ride cost [rad/m]", 3)
    _curve(pen, ride, ride.distances, profile.c_r[nearest])
    _distances(pen, ride)
    if not len(known):
        pen.text((left + width / 2, top + split / 2), "heights along the way are not known", FAINT, anchor="mm")


def _frame(pen: Pen, axes: _Axes, label: str, most: int) -> None:
    right, bottom = axes.left + axes.width, axes.top + axes.height
    values, decimals = ticks(axes.low, axes.high, most)
    for value, row in zip(values, axes.rows(np.array(values)).tolist(), strict=True):
        pen.line(np.array([[axes.left, row], [right, row]]), GRID)
        pen.text((axes.left - 8, row), f"{value:,.{decimals}f}", FAINT, size=14, anchor="rm")
    pen.rectangle((axes.left, axes.top, right, bottom), None, FAINT)
    pen.upright_text((axes.left - 68, axes.top + axes.height / 2), label, INK, 15)


def _distances(pen: Pen, axes: _Axes) -> None:
    bottom = axes.top + axes.height
    in_km = axes.far >= 5000.0
    values, decimals = ticks(0.0, axes.far / (1000.0 if in_km else 1.0), 10)
    for value in values:
        place = axes.left + value * (1000.0 if in_km else 1.0) / axes.far * axes.width
        pen.line(np.array([[place, bottom], [place, bottom + 6]]), FAINT)
        pen.text((place, bottom + 17), f"{value:,.{decimals}f}", FAINT, size=14, anchor="mm")
    unit = "km" if in_km else "m"
    pen.text((axes.left + axes.width / 2, bottom + 40), f"distance along the way [{unit}]", INK, size=15, anchor="mm")


def _fill_ground(pen: Pen, axes: _Axes, profile: RouteProfile, scale: RideScale) -> None:
    """Fill the ground under the curve of the heights, each column in the colour of its ride cost."""
    # NaN on either side makes what lies between unknown too
    row = axes.rows(np.interp(axes.distances, profile.distance, profile.z)) - axes.top
    c_r = profile.c_r[_nearest(profile.distance, axes.distances)]
    colour = scale.colours(c_r)
    colour[np.isnan(c_r)] = UNKNOWN_SHADE
    colour = 255.0 + _FILL * (colour - 255.0)
    canvas: Pixels = np.full((axes.height, axes.width, 3), 255, np.uint8)
    under = np.arange(axes.height)[:, None] + 0.5 >= row[None, :]  # False where the height is unknown
    canvas[under] = np.broadcast_to(colour.astype(np.uint8), canvas.shape)[under]
    pen.paste(axes.left, axes.top, canvas)


def _fill_interval(pen: Pen, axes: _Axes, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
    """Fill what lies between two curves, (width,) each."""
    upper, lower = axes.rows(high) - axes.top, axes.rows(low) - axes.top
    line = np.arange(axes.height)[:, None] + 0.5
    canvas: Pixels = np.full((axes.height, axes.width, 3), 255, np.uint8)
    canvas[(line >= upper[None, :]) & (line <= lower[None, :])] = INTERVAL
    pen.paste(axes.left, axes.top, canvas)


def _curve(pen: Pen, axes: _Axes, distance: NDArray[np.float64], values: NDArray[np.float64]) -> None:
    """Draw a curve, with gaps where values are NaN."""
    known = np.flatnonzero(np.isfinite(values))
    for run in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        if len(run) > 1:
            pen.line(axes.points(distance[run], values[run]), INK, 1.5)


def _nearest(known: NDArray[np.float64], wanted: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the index of the nearest of sorted values."""
    after = np.clip(np.searchsorted(known, wanted), 0, len(known) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(wanted - known[before]) <= np.abs(known[after] - wanted), before, after)
