"""Charts as inline SVG: one frame with two axes, in which marks and lines are drawn.

They hold numbers and words that stand here, nothing that a file or a user wrote: templates do not escape them.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NORMAL_80, count_text
from bumpymap.layers import OFF_COLOURS, UNKNOWN_COLOUR, RideScale

if TYPE_CHECKING:
    from bumpymap.core import CheckResult
    from bumpymap.layers import MapOffset

_LINES, _FAINT, _DARK, _ERROR, _LINE = "#e2e4e8", "#6b7280", "#1f2937", "#9aa0a8", "#2563a8"
_STEPS = (1, 2, 5)
"""Times a power of ten: the numbers at an axis."""
_SIDES = (64, 12, 12, 48)
"""Space left of the frame, right of it, above and below, pixels."""
_ROOM, _LEAST_SPAN = 1.15, 4.0
"""Of a logarithmic axis: factor between its outermost value and its end, and least ratio of its ends. Chosen."""
Part = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""From values to their place along an axis: 0 at its lower end, 1 at its upper."""


@dataclass
class Chart:
    """A chart in the making."""

    title: str
    """Read to those who do not see it."""
    key: str
    """Its id on the page."""
    width: int
    height: int
    x_part: Part
    y_part: Part
    caption: str
    note: str = ""
    is_narrow: bool = False
    """True if it must not grow as wide as the page."""
    elements: list[str] = field(default_factory=list)

    @property
    def frame(self) -> tuple[int, int, int, int]:
        """Left, right, top and bottom of the frame, pixels."""
        left, right, top, bottom = _SIDES
        return left, self.width - right, top, self.height - bottom

    def x(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return pixels to the right."""
        left, right, _, _ = self.frame
        return np.asarray(left + (right - left) * self.x_part(values), dtype=np.float64)

    def y(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return pixels down."""
        _, _, top, foot = self.frame
        return np.asarray(foot - (foot - top) * self.y_part(values), dtype=np.float64)

    def path(self, shape: str, stroke: str, more: str = "") -> None:
        """Draw a path; ``more`` holds other attributes."""
        self.elements.append(f'<path d="{shape}" stroke="{stroke}"{more}/>')

    def paths(self, shape: str, stroke: str, *columns: NDArray[np.float64], more: str = "") -> None:
        """Draw one path of a shape for each row of some columns of numbers, in pixels."""
        rows = zip(*(column.tolist() for column in columns), strict=True)
        self.path("".join(shape.format(*row) for row in rows), stroke, more)

    def text(self, x: float, y: float, text: str, anchor: str = "middle") -> None:
        """Write a text."""
        place = " ".join(
            f'{key}="{at if isinstance(at, int) else format(at, ".1f")}"' for key, at in (("x", x), ("y", y))
        )
        self.elements.append(f'<text {place} text-anchor="{anchor}">{text}</text>')

    def names(self, below: str, beside: str) -> None:
        """Write what the axes show."""
        left, right, top, foot = self.frame
        self.text((left + right) / 2, self.height - 8, below)
        turned = f'transform="translate(16 {(top + foot) / 2}) rotate(-90)"'
        self.elements.append(f'<text {turned} text-anchor="middle">{beside}</text>')

    def discs(
        self, x: NDArray[np.float64], y: NDArray[np.float64], offset: "MapOffset", order: NDArray[np.int64], size: float
    ) -> None:
        """Draw the marks of stretches: larger where errors do not explain how far the map is off."""
        marks = zip(x.tolist(), y.tolist(), offset.kind[order].tolist(), offset.is_off[order].tolist(), strict=True)
        self.elements += [
            '<circle cx="{:.1f}" cy="{:.1f}" r="{:g}" fill="#{:02x}{:02x}{:02x}" stroke="#1c1e22" stroke-width="{}"/>'
            "".format(at, up, (5.5 if off else 4) * size, *OFF_COLOURS[kind][:3], 2 if off else 1)
            for at, up, kind, off in marks
        ]


def ticks(high: float, most: int) -> list[float]:
    """Return round numbers from 0 to high: multiples of 1, 2 or 5 times a power of ten, at most ``most`` steps."""
    least = high / most
    power = 10.0 ** math.floor(math.log10(least))
    step = next(step for step in (power, 2 * power, 5 * power, 10 * power) if step >= least * (1 - 1e-9))
    return [round(number * step, 12) for number in range(math.floor(high / step + 1e-9) + 1)]


_FACTOR = 1.5
"""Thin lines: map and drive differ by this factor."""


def drive_chart(result: "CheckResult") -> Chart | None:
    """Return measured over predicted C_r, one mark a stretch; None if nothing can be compared."""
    from bumpymap.layers import MapOffset

    stretches, offset = result.stretches, MapOffset.of(result.stretches)
    shown = np.flatnonzero(np.isfinite(offset.ratio))
    if not len(shown):
        return None
    both = np.concatenate([stretches.c_r[shown], stretches.measured[shown]])
    low, high = float(both.min()) / _ROOM, float(both.max()) * _ROOM
    wider = float(max(1.0, np.sqrt(_LEAST_SPAN * low / high)))
    low, high = low / wider, high * wider
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ticks = [value for power in powers for step in _STEPS if low <= (value := float(f"{step}e{power}")) <= high]

    def part(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.log(np.clip(values, low, high) / low) / np.log(high / low), dtype=np.float64)

    caption = "Ride cost of the tiles and as the drives measured it"
    title = f"{caption}: a mark for each of {count_text(len(shown), 'stretch', 'stretches')}"
    note = (
        "One mark a stretch, both axes logarithmic. Grey bars: the map's 80 % interval, and the 80 % error of the "
        f"measurement. Thick line: both agree; thin lines: a factor of {_FACTOR:g}. Brown lines: limits of the classes."
    )
    chart = Chart(title, "chart-drives", 560, 440, part, part, caption, note, is_narrow=True)
    left, right, top, foot = chart.frame
    limits = () if result.ground is None else result.ground.class_limits
    lines = [(value, _LINES) for value in ticks]
    for value, colour in [*lines, *((limit, "#c49678") for limit in limits if low < limit < high)]:
        (x,), (y,) = chart.x(np.array([value])), chart.y(np.array([value]))
        chart.path(f"M{x:.1f} {top}V{foot}M{left} {y:.1f}H{right}", colour)
    for value in ticks:
        (x,), (y,) = chart.x(np.array([value])), chart.y(np.array([value]))
        chart.text(x, foot + 16, f"{value:g}")
        chart.text(left - 6, y + 4, f"{value:g}", "end")
    for factor, colour, width in ((1 / _FACTOR, _FAINT, 1), (1.0, _DARK, 2), (_FACTOR, _FAINT, 1)):
        ends = np.array([max(low, low / factor), min(high, high / factor)])
        (west, east), (foot_y, top_y) = chart.x(ends), chart.y(ends * factor)
        chart.path(f"M{west:.1f} {foot_y:.1f}L{east:.1f} {top_y:.1f}", colour, f' stroke-width="{width}"')
    chart.names("C_r of the tiles, rad/m", "C_r measured by the drive, rad/m")
    c_r, measured = stretches.c_r[shown], stretches.measured[shown]
    half = NORMAL_80 * np.nan_to_num(stretches.measured_sd[shown])
    sides = [np.where(np.isfinite(end), end, c_r) for end in (stretches.c_r_low[shown], stretches.c_r_high[shown])]
    across = chart.x(sides[0]), chart.y(measured), chart.x(sides[1])
    upright = chart.x(c_r), chart.y(measured - half), chart.y(measured + half)
    chart.paths("M{:.1f} {:.1f}H{:.1f}M{:.1f} {:.1f}V{:.1f}", _ERROR, *across, *upright, more=' fill="none"')
    order = shown[np.argsort(offset.beyond[shown], kind="stable")]
    chart.discs(chart.x(stretches.c_r[order]), chart.y(stretches.measured[order]), offset, order, 1.0)
    return chart


def along_chart(result: "CheckResult") -> Chart | None:
    """Return what was measured and what the map says, one stretch after another; None if nothing was measured."""
    from bumpymap.layers import MapOffset

    stretches = result.stretches
    length = float(np.sum(stretches.way_m))
    values = np.concatenate([stretches.measured, stretches.c_r, stretches.c_r_high])
    known = values[np.isfinite(values)]
    if length <= 0.0 or not len(known):
        return None
    highest = max(float(np.quantile(known, 0.99)), float(np.nanmax(stretches.measured, initial=0.0))) * 1.08 or 0.1
    on_map = np.flatnonzero(np.isfinite(stretches.c_r))
    caption = "Ride cost along the way"
    title = f"{caption}: {count_text(len(stretches.way_m), 'stretch', 'stretches')}"
    note = "Marks: the drive, with the 80 % error of the measurement."
    note += " Lines on grey: the map by tiles, with its 80 % interval." if len(on_map) else ""
    note += " Blue: the map by the driven line." if result.by_line is not None else ""
    parts: tuple[Part, Part] = (lambda x: x / length, lambda y: np.clip(y / highest, 0.0, 1.0))
    chart = Chart(title, "along", 1120, 260, *parts, caption, note)
    left, right, top, foot = chart.frame
    for value in ticks(highest, 5):
        (y,) = chart.y(np.array([value]))
        chart.path(f"M{left} {y:.1f}H{right}", _LINES)
        chart.text(left - 6, y + 4, f"{value:g}", "end")
    for value in ticks(length, 10):
        chart.text(float(chart.x(np.array([value]))[0]), foot + 16, f"{value:,g}")
    sides = chart.x(np.concatenate([[0.0], np.cumsum(stretches.way_m)]))
    ends = [np.where(np.isfinite(end), end, stretches.c_r)[on_map] for end in (stretches.c_r_low, stretches.c_r_high)]
    west, east, low, high = sides[on_map], sides[on_map + 1], chart.y(ends[0]), chart.y(ends[1])
    columns = zip(west.tolist(), low.tolist(), east.tolist(), high.tolist(), strict=True)
    boxes = "".join(f"M{a:.1f} {b:.1f}H{c:.1f}V{d:.1f}H{a:.1f}Z" for a, b, c, d in columns)
    chart.elements.append(f'<path d="{boxes}" fill="#d9dce1"/>')
    chart.paths("M{:.1f} {:.1f}H{:.1f}", _DARK, west, chart.y(stretches.c_r[on_map]), east, more=' stroke-width="2"')
    if result.by_line is not None:
        known = np.flatnonzero(np.isfinite(result.by_line.c_r))
        middle = chart.y(result.by_line.c_r[known])
        chart.paths("M{:.1f} {:.1f}H{:.1f}", _LINE, sides[known], middle, sides[known + 1], more=' stroke-width="2"')
    starts = "".join(f"M{x:.1f} {top}V{foot}" for x in sides[1:-1][np.diff(stretches.drive) != 0].tolist())
    chart.path(starts, _FAINT, ' stroke-width="1.5"')
    offset, measured = MapOffset.of(stretches), np.flatnonzero(np.isfinite(stretches.measured))
    half = NORMAL_80 * np.nan_to_num(stretches.measured_sd[measured])
    felt, x = stretches.measured[measured], ((sides[:-1] + sides[1:]) / 2)[measured]
    chart.paths("M{:.1f} {:.1f}V{:.1f}", _ERROR, x, chart.y(felt - half), chart.y(felt + half))
    chart.discs(x, chart.y(felt), offset, measured, min(1.0, float(np.median(np.diff(sides))) / 9.0))
    chart.names("length of the stretches, one after another, m", "C_r, rad/m")
    return chart


_ACROSS, _GROUND, _RIDE = 1000.0, (3.0, 58.0), (70.0, 99.0)
"""Width of the drawing of a profile; upper and lower side of its two parts."""
_RIDES = ("c_r", "c_r_low", "c_r_high")
"""Columns of a profile: the ride cost and its interval."""
_LEAST_RELIEF_M = 2.0
"""Least span of the heights of a profile, m: a level way must not look like mountains."""


def profile_chart(profile: Mapping[str, NDArray[np.float64]], scale: RideScale) -> dict[str, Any]:
    """Return heights along a way over ground in the colours of the ride cost, and the ride cost with its interval.

    ``profile``: see `DrawnWay.profile`. The result holds paths in a box of 1000 x 100, which may be stretched, places
    and colours of a gradient, and the texts of the axes.
    """
    z, far = profile["z_m"], max(float(profile["distance_m"][-1]), 1.0)
    x = _ACROSS * profile["distance_m"] / far
    known, ends = z[np.isfinite(z)], profile["c_r_high"][np.isfinite(profile["c_r_high"])]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    middle, span = (low + high) / 2, max(high - low, _LEAST_RELIEF_M)
    most = max(scale.anchors[1], float(np.quantile(ends, 0.98)) if len(ends) else 0.0)

    def down(values: NDArray[np.float64], least: float, size: float, sides: tuple[float, float]) -> NDArray[np.float64]:
        return np.asarray(sides[1] - np.clip((values - least) / size, 0.0, 1.0) * (sides[1] - sides[0]), np.float64)

    def path(top: NDArray[np.float64], foot: NDArray[np.float64] | None = None) -> str:
        """Return lines, broken where ``top`` is not known; with ``foot`` areas down to it."""
        known, text = np.flatnonzero(np.isfinite(top if foot is None else top + foot)), ""
        for part in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1) if len(known) else ():
            sides = [np.column_stack([x, top])[part]]
            sides += [] if foot is None else [np.column_stack([x, foot])[part[::-1]]]
            text += "M" + "L".join(f"{right:.1f} {low:.1f}" for right, low in np.concatenate(sides).tolist())
        return text

    ground = down(z, middle - span / 2, span, _GROUND)
    ride, least, largest = (down(profile[key], 0.0, most, _RIDE) for key in _RIDES)
    colours = np.rint(scale.colours(profile["c_r"])).astype(np.uint8)
    colours[np.isnan(profile["c_r"])] = UNKNOWN_COLOUR[:3]
    edges = [float(at) for at in (np.diff(x) / 2 + x[:-1]) / _ACROSS]
    stops = zip([0.0, *edges], [*edges, 1.0], [f"#{colour.tobytes().hex()}" for colour in colours], strict=True)
    return {
        "ground": path(ground, np.full(len(x), _GROUND[1])),
        "height": path(ground),
        "interval": path(largest, least),
        "ride": path(ride),
        "stops": list(stops),
        "heights": [f"{middle + side * span / 2:,.1f} m" for side in (1, -1)] if len(known) else ["not known", ""],
        "rides": [f"{most:.2g} rad/m", "0"],
        "far": f"{far:,.0f} m",
    }


def profile_places(profile: Mapping[str, NDArray[np.float64]]) -> dict[str, Any] | None:
    """Return the places of a profile as the script of the page needs them; None if there are none."""
    if not profile:
        return None
    texts = []
    for along, z, *ride in zip(*(profile[key] for key in ("distance_m", "z_m", *_RIDES)), strict=True):
        height = f"height {z:,.1f} m" if np.isfinite(z) else "height not known"
        level = "ride cost C_r {:.3f} rad/m (80 % interval {:.3f} to {:.3f})".format(*ride)
        level = level if np.isfinite(ride).all() else "C_r not known"
        texts.append(f"{along:,.0f} m along the way · {height} · {level}")
    keys = (("along", "distance_m"), ("east", "east"), ("north", "north"))
    return {name: profile[key].round(1).tolist() for name, key in keys} | {"texts": texts}
