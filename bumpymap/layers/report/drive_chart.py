"""Map against drive on the page of a map: a scatter plot as inline SVG."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CheckResult, DrivenStretches, count_text
from bumpymap.layers.check.offset import LogAxis, MapOffset
from bumpymap.layers.colours import OFF_COLOURS
from bumpymap.layers.report.markup import Html, raw, tag

__all__ = ["drive_chart"]

_WIDTH, _HEIGHT = 560, 440
_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 12, 12, 48
_FACTOR = 1.5
"""Thin lines: map and drive differ by this factor."""
_NORMAL_80 = 1.2816
_TITLE = "Ride cost of the map and as the drives measured it"


def drive_chart(result: CheckResult, key: str) -> Html:
    """Return measured over predicted C_r, one mark a stretch; empty if nothing can be compared.

    Parameters
    ----------
    result : CheckResult
    key : str
        Makes ids on the page differ.
    """
    stretches, offset = result.stretches, MapOffset.of(result.stretches)
    shown = np.flatnonzero(np.isfinite(offset.ratio))
    if not len(shown):
        return Html()
    axis = LogAxis.around(np.concatenate([stretches.c_r[shown], stretches.measured[shown]]))
    limits = () if result.ground is None else result.ground.class_limits
    order = shown[np.argsort(offset.beyond[shown], kind="stable")]
    parts = [*_axes(axis, limits), *_bars(axis, stretches, shown), *_marks(axis, stretches, offset, order)]
    picture = tag(
        "svg",
        tag(
            "title", f"{_TITLE}: a mark for each of {count_text(len(shown), 'stretch', 'stretches')}", id=f"chart-{key}"
        ),
        raw("".join(parts)),
        viewBox=f"0 0 {_WIDTH} {_HEIGHT}",
        role="img",
        aria_labelledby=f"chart-{key}",
    )
    note = (
        ". One mark a stretch, both axes logarithmic. Grey bars: the map's 80 % interval, and the 80 % error of the "
        f"measurement. Thick line: both agree; thin lines: a factor of {_FACTOR:g}. Brown lines: limits of the classes."
    )
    return tag("figure", tag("figcaption", tag("strong", _TITLE), note), picture, class_="plot")


def _across(axis: LogAxis, values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(_LEFT + (_WIDTH - _LEFT - _RIGHT) * axis.part(values), dtype=np.float64)


def _up(axis: LogAxis, values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(_HEIGHT - _BOTTOM - (_HEIGHT - _TOP - _BOTTOM) * axis.part(values), dtype=np.float64)


def _axes(axis: LogAxis, limits: tuple[float, ...]) -> list[str]:
    right, foot, parts = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM, []
    lines = [(value, "#e2e4e8") for value in axis.ticks]
    lines += [(limit, "#c49678") for limit in limits if axis.low < limit < axis.high]
    for value, colour in lines:
        x, y = (float(place(axis, np.array([value]))[0]) for place in (_across, _up))
        parts.append(f'<path d="M{x:.1f} {_TOP}V{foot}M{_LEFT} {y:.1f}H{right}" stroke="{colour}"/>')
    for value in axis.ticks:
        x, y = (float(place(axis, np.array([value]))[0]) for place in (_across, _up))
        parts.append(f'<text x="{x:.1f}" y="{foot + 16}" text-anchor="middle">{value:g}</text>')
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
    for factor, colour, width in ((1 / _FACTOR, "#6b7280", 1), (1.0, "#1f2937", 2), (_FACTOR, "#6b7280", 1)):
        ends = np.array([max(axis.low, axis.low / factor), min(axis.high, axis.high / factor)])
        (left, far), (low, high) = _across(axis, ends).tolist(), _up(axis, ends * factor).tolist()
        parts.append(f'<path d="M{left:.1f} {low:.1f}L{far:.1f} {high:.1f}" stroke="{colour}" stroke-width="{width}"/>')
    middle = (_LEFT + right) / 2
    parts.append(f'<text x="{middle}" y="{_HEIGHT - 8}" text-anchor="middle">C_r of the map, rad/m</text>')
    turned = f'transform="translate(16 {(_TOP + foot) / 2}) rotate(-90)"'
    parts.append(f'<text {turned} text-anchor="middle">C_r measured by the drive, rad/m</text>')
    return parts


def _bars(axis: LogAxis, stretches: DrivenStretches, shown: NDArray[np.int64]) -> list[str]:
    c_r, measured = stretches.c_r[shown], stretches.measured[shown]
    half = _NORMAL_80 * np.nan_to_num(stretches.measured_sd[shown])
    left, right = (
        _across(axis, np.where(np.isfinite(end), end, c_r))
        for end in (stretches.c_r_low[shown], stretches.c_r_high[shown])
    )
    x, y = _across(axis, c_r), _up(axis, measured)
    low, high = _up(axis, measured - half), _up(axis, measured + half)
    columns = (values.tolist() for values in (left, y, right, x, low, high))
    path = "".join(
        f"M{a:.1f} {b:.1f}H{c:.1f}M{d:.1f} {e:.1f}V{f:.1f}" for a, b, c, d, e, f in zip(*columns, strict=True)
    )
    return [f'<path d="{path}" stroke="#9aa0a8" fill="none"/>']


def _marks(axis: LogAxis, stretches: DrivenStretches, offset: MapOffset, order: NDArray[np.int64]) -> list[str]:
    x, y = _across(axis, stretches.c_r[order]).tolist(), _up(axis, stretches.measured[order]).tolist()
    marks = zip(x, y, offset.kind[order].tolist(), offset.is_off[order].tolist(), strict=True)
    return [
        f'<circle cx="{at:.1f}" cy="{up:.1f}" r="{5.5 if off else 4}" fill="#{_hex(kind)}" stroke="#1c1e22" '
        f'stroke-width="{2 if off else 1}"/>'
        for at, up, kind, off in marks
    ]


def _hex(kind: int) -> str:
    return "".join(f"{channel:02x}" for channel in OFF_COLOURS[kind][:3])
