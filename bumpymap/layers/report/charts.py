"""Histograms as inline SVG, each with its numbers as text."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bumpymap.layers.report.markup import Html, join, raw, share, shares, table, tag, whole
from bumpymap.layers.report.tiles import C_R_EDGES, SLOPE_EDGES

__all__ = ["c_r_chart", "lines_of", "slope_chart", "swatch"]

_WIDTH, _HEIGHT = 560, 210
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 12, 24, 40
_MARK = "#a3261b"


def c_r_chart(bins: NDArray[np.int64], limits: Sequence[float], key: str) -> Html:
    """Return the histogram of the ride cost: bins of equal width on a logarithmic axis.

    Parameters
    ----------
    bins : int64 (n,)
        Tiles in each bin of ``C_R_EDGES``.
    limits : sequence of float
        Limits of the classes, rad/m.
    key : str
        Makes ids on the page differ.
    """
    used = np.flatnonzero(bins)
    first, last = (int(used[0]), int(used[-1]) + 1) if len(used) else (0, len(bins))
    # the first and the last bin have no length of their own on the axis
    at = np.log10(np.concatenate([[C_R_EDGES[1] * 10 ** (-1 / 8)], C_R_EDGES[1:-1], [C_R_EDGES[-2] * 10 ** (1 / 8)]]))
    ticks = [(np.log10(value), f"{value:g}") for value in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)]
    marks = [(float(np.log10(limit)), f"{limit:g}") for limit in limits if limit > 0]
    rows = [
        (_between(C_R_EDGES[bin_], C_R_EDGES[bin_ + 1], 3), whole(int(bins[bin_])), told)
        for bin_, told in zip(range(first, last), shares(bins[first:last].tolist()), strict=True)
    ]
    title = "Ride cost C_r of the tiles"
    note = f"Red lines: limits of the classes, {', '.join(text for _, text in marks)} rad/m." if marks else ""
    picture = _histogram(bins[first:last], at[first : last + 1], ticks, marks, (title, "C_r, rad/m", key))
    return _figure(picture, title, note, "C_r, rad/m", rows)


def slope_chart(bins: NDArray[np.int64], limit: float | None, key: str) -> Html:
    """Return the histogram of the slope; ``limit`` is the steepest that the vehicle may drive, degrees."""
    used = np.flatnonzero(bins)
    last = max(int(used[-1]) + 1 if len(used) else 1, 4)
    ticks = [(float(value), f"{value:g}°") for value in range(0, 91, 10)]
    marks = [] if limit is None else [(limit, f"{limit:g}°")]
    rows = [
        (f"{SLOPE_EDGES[bin_]:g} to {SLOPE_EDGES[bin_ + 1]:g}", whole(int(bins[bin_])), told)
        for bin_, told in zip(range(last), shares(bins[:last].tolist()), strict=True)
    ]
    title = "Slope of the tiles"
    note = f"Red line: steepest slope for the vehicle, {limit:g} degrees." if limit is not None else ""
    picture = _histogram(bins[:last], SLOPE_EDGES[: last + 1], ticks, marks, (title, "slope, degrees", key))
    return _figure(picture, title, note, "slope, degrees", rows)


def _figure(picture: Html, title: str, note: str, what: str, rows: Sequence[tuple[str, ...]]) -> Html:
    numbers = tag("details", tag("summary", "The numbers"), table(title, (what, "tiles", "share"), rows))
    return tag("figure", tag("figcaption", tag("strong", title), f". {note}" if note else ""), picture, numbers)


def _between(low: float, high: float, decimals: int) -> str:
    if low == 0:
        return f"under {high:.{decimals}f}"
    return f"over {low:.{decimals}f}" if not np.isfinite(high) else f"{low:.{decimals}f} to {high:.{decimals}f}"


def _histogram(
    counts: NDArray[np.int64],
    edges: NDArray[np.float64],
    ticks: Sequence[tuple[float, str]],
    marks: Sequence[tuple[float, str]],
    names: tuple[str, str, str],
) -> Html:
    title, axis, key = names
    most = max(int(counts.max()), 1)
    across = (_WIDTH - _LEFT - _RIGHT) / (edges[-1] - edges[0])
    foot = _HEIGHT - _BOTTOM
    tall = foot - _TOP

    def x(value: float) -> float:
        return float(_LEFT + (value - edges[0]) * across)

    parts = []
    for part in (0.0, 0.5, 1.0):
        y = foot - tall * part
        parts.append(f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#d8dbdf"/>')
        label = share(most * part, max(int(counts.sum()), 1)) if part else "0"
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{label}</text>')
    for count, low, high in zip(counts.tolist(), edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        height = tall * count / most
        parts.append(
            f'<rect x="{x(low) + 0.5:.1f}" y="{foot - height:.1f}" width="{max(x(high) - x(low) - 1, 0.5):.1f}" '
            f'height="{height:.1f}" fill="#3f6488"/>'
        )
    for value, text in ticks:
        if edges[0] <= value <= edges[-1]:
            parts.append(f'<text x="{x(value):.1f}" y="{foot + 16}" text-anchor="middle">{text}</text>')
    for value, text in marks:
        if edges[0] <= value <= edges[-1]:
            parts.append(
                f'<line x1="{x(value):.1f}" x2="{x(value):.1f}" y1="{_TOP - 6}" y2="{foot}" stroke="{_MARK}"/>'
            )
            parts.append(f'<text x="{x(value):.1f}" y="{_TOP - 10}" text-anchor="middle" fill="{_MARK}">{text}</text>')
    parts.append(f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2}" y="{_HEIGHT - 6}" text-anchor="middle">{axis}</text>')
    ident = f"chart-{key}"
    return tag(
        "svg",
        tag("title", f"{title}: histogram, numbers in the table below it", id=ident),
        raw("".join(parts)),
        viewBox=f"0 0 {_WIDTH} {_HEIGHT}",
        role="img",
        aria_labelledby=ident,
    )


def swatch(colour: tuple[int, ...], *, hatched: bool = False, falling: bool = False) -> Html:
    """Return a small square of a colour, which stands beside the words that say the same.

    Lines rise to the right, as on ground that is not known, or are ``falling``, as on ground that is not passable.
    """
    fill = f"#{colour[0]:02x}{colour[1]:02x}{colour[2]:02x}"
    path = '<path d="M0 7 7 14M0 0 14 14M7 0 14 7" stroke="#111" fill="none"/>'
    path = path if falling else '<path d="M0 7 7 0M5 14 14 5" stroke="#555" fill="none"/>'
    lines = path if hatched else ""
    square = f'<rect width="14" height="14" rx="2" fill="{fill}" stroke="#6b7280"/>'
    return raw(f'<svg class="swatch" viewBox="0 0 14 14" aria-hidden="true">{square}{lines}</svg>')


def lines_of(*items: str) -> Html:
    """Return a list of items."""
    return tag("ul", join(*(tag("li", item) for item in items)))
