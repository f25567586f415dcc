"""Write the report of an evaluation: Markdown, JSON and plots."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import CLASS_NAMES, UsageError, atomic
from bumpymap.lab.evaluate.agreement import ClassTable, Comparison, VehicleOrder
from bumpymap.lab.evaluate.rated_survey import MAPPED
from bumpymap.lab.evaluate.survey_trial import ComparedPatches, Findings

__all__ = [
    "REPORT",
    "confusion_lines",
    "number",
    "percent",
    "report_text",
    "require_matplotlib",
    "section",
    "table",
    "write_document",
    "write_report",
]

REPORT = "report.md"
_RECORD = "report.json"
_NONE = "-"


def write_document(out: Path, text: str, kind: str, record: dict[str, Any]) -> list[Path]:
    """Write ``report.json`` and ``report.md`` into a folder, in this order.

    Parameters
    ----------
    out : Path
    text : str
        Text of the report.
    kind : str
        Format name of the JSON file.
    record : dict
        Nested records of numbers, strings and arrays.
    """
    content = {"format": kind, "version": 1} | plain_record(record)
    with atomic(out / _RECORD) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    with atomic(out / REPORT) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return [out / REPORT, out / _RECORD]


def report_text(title: str, opening: Sequence[str], sections: Iterable[list[str]]) -> str:
    """Assemble the text of a report."""
    lines = [f"# {title}", "", *opening, *(line for part in sections for line in part)]
    return "\n".join(lines).rstrip() + "\n"


def section(title: str, intro: str, lines: Sequence[str]) -> list[str]:
    """Return the lines of a section, or none if ``lines`` is empty. ``intro`` may be empty."""
    return [f"## {title}", "", *([intro, ""] if intro else []), *lines] if lines else []


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return [*lines, *(f"| {' | '.join(row)} |" for row in rows), ""]


def number(value: float, digits: int = 3) -> str:
    """Format a number with ``digits`` significant digits; a dash if it is not finite."""
    return f"{value:.{digits}g}" if math.isfinite(value) else _NONE


def percent(share: float) -> str:
    """Format a share of 0..1 as per cent; a dash if it is not finite."""
    return f"{100 * share:.1f} %" if math.isfinite(share) else _NONE


def plain_record(value: Any) -> Any:
    """Convert nested records to plain JSON: six digits, None for non-finite numbers, sets as sorted lists."""
    if isinstance(value, dict):
        return {str(key): plain_record(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple | frozenset):
        return [plain_record(item) for item in (sorted(value) if isinstance(value, frozenset) else value)]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


_PAPER_CLASSES = (
    ("paper, first site", (0.0039, 0.0329, 0.0952, 36.1), (0.0369, 0.0788, 0.1718, 3.62)),
    ("paper, second site", (0.0096, 0.0693, 0.1517, 0.6955), (0.036, 0.0961, 0.0932, 0.1759)),
)
"""The paper's Table I: variance [m2] and residual [m] of class 0 to 3."""
_COLUMN = {
    "variance_median": "median variance",
    "residual_median": "median residual",
    "c_r_median": "median C_r",
    "variance_mean": "mean variance",
    "residual_mean": "mean residual",
}


def class_lines(classes: Mapping[str, ClassTable]) -> list[str]:
    """Return Table I of each rating, followed by the paper's."""
    rows = []
    for rating, found in classes.items():
        for row in found.rows:
            values = (row.variance_median, row.variance_mean, row.residual_median, row.residual_mean, row.c_r_median)
            name = f"{row.class_id} {CLASS_NAMES[row.class_id]}"
            rows.append([rating, name, str(row.tiles), percent(row.share), *map(number, values)])
    for site, variance, residual in _PAPER_CLASSES:
        for class_id, (square, away) in enumerate(zip(variance, residual, strict=True)):
            rows.append([site, str(class_id), _NONE, _NONE, _NONE, number(square), _NONE, number(away), _NONE])
    header = ("rating", "class", "tiles", "share", "variance [m2], median", "mean", "residual [m], median", "mean")
    return [*table((*header, "C_r [rad/m], median"), rows), *(_rises(name, found) for name, found in classes.items())]


def _rises(rating: str, found: ClassTable) -> str:
    missing = [str(row.class_id) for row in found.rows if not row.tiles]
    falls = [_COLUMN[name] for name, rises in found.rises.items() if not rises]
    summary = f"`{rating}`: " + (
        f"from class to class these do not rise everywhere: {', '.join(falls)}."
        if falls
        else "variance, residual and C_r rise from class to class, in median and mean."
    )
    return f"- {summary}" + (f" No tile is of class {', '.join(missing)}." if missing else "")


def driven_lines(found: Comparison) -> list[str]:
    """Return the table of all predictors compared with the drives."""
    rows = []
    for name, own in found.agreement.items():
        held = percent(own.coverage.held) if own.coverage else _NONE
        auc = (number(own.fail.auc), number(own.fail.auc_below_limit)) if own.fail else (_NONE, _NONE)
        steps = (percent(own.steps.same), percent(own.steps.one_off), percent(own.steps.further))
        ranks = (f"{own.spearman:.4f}", f"{1 - own.spearman:.4f}") if math.isfinite(own.spearman) else (_NONE, _NONE)
        rows.append(
            [
                f"`{name}`",
                *ranks,
                percent(own.median_error),
                percent(own.fitted_error),
                number(own.median_ratio),
                *steps,
                held,
                *auc,
            ]
        )
    header = ("predictor", "Spearman", "1 - Spearman", "median error", "fitted to these")
    more = (
        "median predicted / driven",
        "same class",
        "one off",
        "two or more off",
        "80 % interval contains it",
        "p_fail AUC",
        "within slope limit",
    )
    return table((*header, *more), rows)


def confusion_lines(name: str, confusion: Sequence[Sequence[int]], truth: str, found: str) -> list[str]:
    """Return a confusion matrix as a table; ``truth`` and ``found`` label its rows and columns, such as *driven*."""
    rows = [[f"{truth} {class_id}", *map(str, line)] for class_id, line in enumerate(confusion)]
    return table((f"`{name}`", *(f"{found} {class_id}" for class_id in range(len(rows)))), rows)


def reliability_lines(found: Comparison) -> list[str]:
    """Return the table of predicted and driven failures."""
    rows = [
        [f"`{name}`", number(one.predicted), number(one.share_failed), str(one.patches)]
        for name, own in found.agreement.items()
        if own.fail
        for one in own.fail.reliability
        if one.patches
    ]
    return table(("rating", "mean p_fail of the bin", "share of drives that failed", "patches"), rows)


def order_lines(orders: Sequence[VehicleOrder]) -> list[str]:
    """Return the table of the order of vehicles."""
    rows = [
        [
            f"`{one.rating}`",
            ", ".join(one.vehicles),
            str(one.patches),
            percent(one.same),
            str(one.clear_patches),
            percent(one.clear_same),
        ]
        for one in orders
    ]
    header = ("rating", "vehicles", "patches", "same order", "patches that separate them", "same order there")
    return table(header, rows)


_COLOUR = {"ride": "#2a7f62", "table": "#c77c11"}


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


_PLAIN = ("z_variance", "ransac_residual", "slope_free_sd")


def write_report(findings: Findings, out: Path) -> list[Path]:
    """Write the plots, ``report.json`` and ``report.md``, in this order."""
    pictures = draw(findings, out)
    files = write_document(out, markdown(findings, pictures), "bumpymap-evaluation", asdict(findings))
    return [*files, *(out / name for name in pictures.values())]


def markdown(findings: Findings, pictures: dict[str, str]) -> str:
    """Return the text of the report; ``pictures`` maps part of the report -> file."""
    found = findings
    classes = [*class_lines(found.classes), ""] if found.classes else []
    sections = [
        section("Statistics of the classes", "The paper's Table I, over all classified tiles.", classes),
        *(_driven(vehicle, own, pictures) for vehicle, own in found.comparisons.items()),
        section("Order of the vehicles", _ORDER, order_lines(found.orders) if found.orders else []),
    ]
    return report_text("Can the map be trusted?", [*_opening(found), *_conclusion(found)], sections)


def _picture(title: str, file: str | None) -> list[str]:
    return [f"![{title}]({file})", ""] if file else []


_ORDER = (
    "On each patch the vehicles are sorted by predicted and by driven C_r. Only patches on which the C_r of every "
    "vehicle can be compared are counted. The drives separate the vehicles if neighbours differ by more than two "
    "standard errors."
)


def _opening(findings: Findings) -> list[str]:
    facts = findings.facts
    points = "points of class 2 (ground) only" if facts["ground_only"] else "all points"
    why = ", ".join(f"{name}: {count}" for name, count in facts["unknown_tiles"].items())
    unknown = f"{sum(facts['unknown_tiles'].values())} unknown" + (f" ({why})" if why else "")
    first = (
        f"Survey {', '.join(facts['files'])}: {facts['points']:,} points, measured from {points}; "
        f"{facts['judged_tiles']} tiles classified, {unknown}, "
        f"{facts['density']:.0f} points per m2 on the classified ones."
    )
    rows = [
        [
            one["vehicle"],
            f"`{one['calibration']}`",
            " / ".join(number(limit) for limit in one["class_limits"]),
            ", ".join(f"`{name}`" for name in one["ratings"]),
        ]
        for one in findings.vehicles
    ]
    return [first, "", *table(("vehicle", "calibration", "class limits [rad/m]", "ratings"), rows)]


def _conclusion(findings: Findings) -> list[str]:
    """Summarise the comparison with the drives."""
    lines = []
    for vehicle, found in findings.comparisons.items():
        for name in MAPPED:
            if name in found.agreement and found.patches > found.left_out:
                own = found.agreement[name]
                held = f"; {percent(own.coverage.held)} of its 80 % intervals contain it" if own.coverage else ""
                lines.append(
                    f"- **{vehicle}, `{name}`**: C_r is off by {percent(own.median_error)} in the median{held}; "
                    f"{percent(own.steps.same)} of the classes are the driven ones, {percent(own.steps.further)} are "
                    f"off by two or more."
                )
    return [*lines, ""] if lines else []


def _driven(vehicle: str, found: Comparison, pictures: dict[str, str]) -> list[str]:
    confusions = [
        line
        for name in MAPPED
        if name in found.agreement
        for line in confusion_lines(name, found.agreement[name].confusion, "driven", "predicted")
    ]
    lines = [
        *driven_lines(found),
        *_against_plain(found),
        *_picture("Predicted against driven C_r", pictures[f"scatter {vehicle}"]),
        *confusions,
        "Failed drives by predicted `p_fail`, in bins of width 0.2; all patches have the same weight:",
        "",
        *reliability_lines(found),
        *_picture("Predicted against driven failures", pictures[f"reliability {vehicle}"]),
    ]
    return section(f"Predicted and driven: {vehicle}", _method(found), lines)


def _method(found: Comparison) -> str:
    noise = (
        " `ride_raw` is `ride` without noise correction: the drives run on the measured relief and contain its noise "
        "too, while `ride` predicts the ground without noise."
    )
    return (
        f"{found.patches} patches, {found.drives} drives, {found.failed} of them failed. On {found.left_out} patches "
        "more than a quarter of the drives failed; their C_r, of the completed drives only, is not compared. The "
        f"standard error of the driven C_r is {percent(found.label_error)} in the median, and above 5 % on "
        f"{found.label_error_over} patches. "
        "Failures are compared on all patches, classes on those within the vehicle's slope limit: "
        f"{found.beyond_limit} are beyond it and have class 3 by definition. "
        f"As some drives over a patch fail and others do not, no p_fail can reach an AUC above {found.auc_most:.3f}, "
        f"or above {found.auc_most_below_limit:.3f} within the slope limit. Plain "
        "predictors get C_r from their best monotone fit to the drives over the other patches, which a map does not "
        "have; *fitted to these* is the error if the fit includes the patch itself."
        + (noise if "ride_raw" in found.agreement else "")
    )


def _against_plain(found: Comparison) -> list[str]:
    plain = {name: 1 - found.agreement[name].spearman for name in _PLAIN if name in found.agreement}
    known = {name: lack for name, lack in plain.items() if math.isfinite(lack)}
    if not known or min(known.values()) <= 0:
        return []
    best = min(known, key=lambda name: known[name])
    ratios = [
        f"{(1 - found.agreement[name].spearman) / known[best]:.2f} times for `{name}`"
        for name in ("ride", "ride_raw", "table")
        if name in found.agreement and math.isfinite(found.agreement[name].spearman)
    ]
    return [f"1 - Spearman relative to that of the best plain predictor, `{best}`: {', '.join(ratios)}.", ""]
