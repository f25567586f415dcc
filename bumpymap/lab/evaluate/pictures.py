"""Plots of the findings as PNG, drawn without a display."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import UsageError, atomic
from bumpymap.lab.evaluate.findings import ComparedPatches, Findings
from bumpymap.lab.evaluate.subject import MAPPED

__all__ = ["draw", "require_matplotlib"]

_COLOUR = {"ride": "#2a7f62", "table": "#c77c11"}
_LEAST_DRAWN = 1e-4
"""Lower bound of plotted C_r, rad/m; smaller values are not perceptible."""
_NOISE_COLOURS = ("#2a7f62", "#3b73b9", "#c77c11", "#b03a48")


def require_matplotlib() -> None:
    """Raise UsageError if matplotlib is not installed, so that a long evaluation does not fail at its end."""
    try:
        import matplotlib  # noqa: F401, ICN001 (only a test of availability)
    except ImportError as error:
        raise UsageError(
            "evaluate draws its pictures with matplotlib, which is not installed; pip install 'bumpymap[sim]'"
        ) from error


def draw(findings: Findings, out: Path) -> dict[str, str]:
    """Draw all plots for which there are data; return part of the report -> name of the file."""
    files: dict[str, str] = {}
    for vehicle, patches in findings.patches.items():
        names = [name for name in MAPPED if name in patches.verdicts]
        plain = "".join(letter if letter.isalnum() else "_" for letter in vehicle)
        files[f"scatter {vehicle}"] = _save(out / f"driven_{plain}.png", _scatter, len(names), patches, names)
        files[f"reliability {vehicle}"] = _save(out / f"failures_{plain}.png", _reliability, 1, findings, vehicle)
    if findings.densities:
        files["density"] = _save(out / "density.png", _density, 1, findings)
    if findings.noise:
        files["noise"] = _save(out / "noise.png", _noise, 1, findings)
    return files


def _save(path: Path, paint: Callable[..., None], panels: int, *what: Any) -> str:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5 * panels, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    paint(figure.subplots(1, panels, squeeze=False)[0], *what)
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})
    return path.name


def _scatter(axes: Any, patches: ComparedPatches, names: list[str]) -> None:
    good = patches.driven.comparable
    driven = patches.driven.c_r[good]
    for axis, name in zip(axes, names, strict=True):
        verdict = patches.verdicts[name].take(good)
        below, above = verdict.c_r - verdict.c_r_low, verdict.c_r_high - verdict.c_r
        axis.errorbar(driven, verdict.c_r, [below, above], fmt="none", ecolor="0.8", elinewidth=0.7, zorder=1)
        axis.scatter(driven, verdict.c_r, s=10, color=_COLOUR[name], zorder=2)
        if len(driven):
            ends = [min(driven.min(), verdict.c_r.min()) * 0.8, max(driven.max(), verdict.c_r.max()) * 1.25]
            axis.plot(ends, ends, color="0.4", linewidth=0.8)
            axis.set(xlim=ends, ylim=ends, xscale="log", yscale="log")
            _plain_ticks(axis, both=True)
        axis.set(xlabel="driven C_r [rad/m]", ylabel="predicted C_r [rad/m], 80 % interval")
        axis.set_title(f"{name}: {len(driven)} patches", loc="left")


def _plain_ticks(axis: Any, *, both: bool) -> None:
    """Label a logarithmic axis with plain numbers: 0.1, 0.2, 0.5, 1."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    for side in (axis.xaxis, axis.yaxis) if both else (axis.xaxis,):
        side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        side.set_minor_locator(NullLocator())


def _reliability(axes: Any, findings: Findings, vehicle: str) -> None:
    axis = axes[0]
    axis.plot([0, 1], [0, 1], color="0.6", linewidth=0.8)
    for name, own in findings.comparisons[vehicle].agreement.items():
        if own.fail and name in MAPPED:
            bins = [one for one in own.fail.reliability if one.patches]
            x, y = [one.predicted for one in bins], [one.share_failed for one in bins]
            axis.plot(x, y, "o-", color=_COLOUR[name], label=f"{name}, AUC {own.fail.auc:.3f}")
    axis.set(xlabel="predicted p_fail", ylabel="share of drives that failed", xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
    axis.legend(frameon=False)


def _density(axes: Any, findings: Findings) -> None:
    axis = axes[0]
    for name in dict.fromkeys(row.rating for row in findings.densities):
        rows = [row for row in findings.densities if row.rating == name]
        x = [row.density for row in rows]
        axis.plot(x, [row.same_class for row in rows], "o-", color=_COLOUR[name], label=f"{name}: same class")
        axis.plot(x, [row.still_judged for row in rows], "o:", color=_COLOUR[name], label=f"{name}: still judged")
    axis.set(xscale="log", xlabel="points per m2", ylabel="share of the tiles", ylim=(0, 1.03))
    _plain_ticks(axis, both=False)
    axis.legend(frameon=False)


def _noise(axes: Any, findings: Findings) -> None:
    axis = axes[0]
    axis.axhspan(_LEAST_DRAWN / 2, _LEAST_DRAWN, color="0.93")
    levels = dict.fromkeys(row.noise_m for row in findings.noise)
    for noise, colour in zip(levels, _NOISE_COLOURS, strict=False):
        rows = [row for row in findings.noise if row.noise_m == noise]
        x = np.array([row.density for row in rows])
        flat, raw = ([max(getattr(row, kind), _LEAST_DRAWN) for row in rows] for kind in ("flat", "flat_raw"))
        axis.plot(x, flat, "o-", color=colour, label=f"{100 * noise:g} cm, denoised")
        axis.plot(x, raw, "o:", color=colour, label=f"{100 * noise:g} cm, not denoised")
    axis.set(xscale="log", yscale="log", xlabel="points per m2", ylabel="median C_r of dead-flat ground [rad/m]")
    axis.set_ylim(bottom=_LEAST_DRAWN / 2)
    axis.legend(frameon=False, fontsize=7, loc="upper center", bbox_to_anchor=(0.5, 1.22), ncols=2)
    _plain_ticks(axis, both=False)
