"""Plots of an evaluation of routes as PNG, drawn without a display."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bumpymap.core import Barred, atomic

if TYPE_CHECKING:
    from bumpymap.lab.evaluate.routes.run import RouteFindings, RouteTrialData

__all__ = ["draw_routes"]

_COLOUR = {"best": "#2a7f62", "straight": "#c77c11"}


def draw_routes(findings: "RouteFindings", data: "RouteTrialData", out: Path) -> list[str]:
    """Draw predicted against driven C_r, and the map with all ways; return the names of the files."""
    return [
        _save_figure(out / "ways_driven.png", (5.0, 4.6), _scatter_ways, findings),
        _save_figure(out / "ways_map.png", (8.0, 7.6), _map_of_ways, data),
    ]


def _save_figure(path: Path, size: tuple[float, float], paint: Any, what: Any) -> str:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    paint(figure.subplots(), what)
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})
    return path.name


def _scatter_ways(axis: Any, findings: "RouteFindings") -> None:
    ends = []
    for name, colour in _COLOUR.items():
        ways = [way for way in findings.of(name) if way.arrived and way.c_r > 0]
        driven, said = [way.c_r for way in ways], [way.predicted.c_r for way in ways]
        below = [way.predicted.c_r - way.predicted.c_r_low for way in ways]
        above = [way.predicted.c_r_high - way.predicted.c_r for way in ways]
        axis.errorbar(driven, said, [below, above], fmt="o", ms=4, color=colour, elinewidth=0.6, label=name)
        raw = [way.predicted.c_r_raw for way in ways]
        axis.plot(driven, raw, "x", ms=4, color=colour, label=f"{name}, without noise correction")
        ends += [*driven, *said]
    if ends:
        limits = [min(ends) * 0.8, max(ends) * 1.25]
        axis.plot(limits, limits, color="0.4", linewidth=0.8)
        axis.set(xlim=limits, ylim=limits)
        axis.legend(frameon=False, fontsize=7)
    axis.set(xlabel="driven C_r of the whole way [rad/m]", ylabel="predicted C_r [rad/m], 80 % interval")


def _map_of_ways(axis: Any, data: "RouteTrialData") -> None:
    field = data.field
    shown = np.where(field.barred == Barred.NO, field.c_r, np.nan)
    axis.imshow(np.where(field.barred[..., None] == Barred.NO, 1.0, 0.82) * np.ones(3), interpolation="nearest")
    painted = axis.imshow(shown, cmap="viridis", interpolation="nearest")
    for number, pair in enumerate(data.pairs):
        for name, line in pair.lines().items():
            style = "-" if name == "best" else ":"
            axis.plot(line[:, 1] - 0.5, line[:, 0] - 0.5, style, color="#d62728", linewidth=1.1)
        axis.annotate(str(number + 1), (pair.best[0, 1] - 0.5, pair.best[0, 0] - 0.5), fontsize=7)
    corners = np.concatenate([line for pair in data.pairs for line in pair.lines().values()])
    (north, west), (south, east) = corners.min(axis=0) - 4, corners.max(axis=0) + 4
    axis.set(xlim=(west, east), ylim=(south, north), xlabel="tiles", ylabel="tiles")
    axis.set_title("best ways (solid) and straight lines (dotted); grey: not passable", loc="left", fontsize=9)
    axis.figure.colorbar(painted, ax=axis, shrink=0.6, label="predicted C_r [rad/m]")
