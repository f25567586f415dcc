"""Markdown tables of the findings, with one-sentence summaries."""

import math
from collections.abc import Mapping, Sequence

from bumpymap.core import CLASS_NAMES
from bumpymap.lab.evaluate.classes import ClassTable
from bumpymap.lab.evaluate.compare import Comparison, KindRow, VehicleOrder
from bumpymap.lab.evaluate.density import DensityRow
from bumpymap.lab.evaluate.document import number, percent, table
from bumpymap.lab.evaluate.invariance import MoveRow
from bumpymap.lab.evaluate.noise import NoiseRow
from bumpymap.lab.evaluate.timing import PAPER, StepCost

__all__ = [
    "class_lines",
    "confusion_lines",
    "density_lines",
    "driven_lines",
    "kind_lines",
    "move_lines",
    "noise_lines",
    "order_lines",
    "reliability_lines",
    "timing_lines",
]

_NONE = "-"
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


def kind_lines(kinds: Sequence[KindRow]) -> list[str]:
    """Return the table of predictions by kind of ground."""
    rows = [
        [
            row.kind,
            str(row.patches),
            str(row.compared),
            percent(row.failed_share),
            percent(row.median_error),
            number(row.median_ratio),
        ]
        for row in kinds
    ]
    return table(("ground", "patches", "compared", "drives failed", "median error", "median predicted / driven"), rows)


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


def density_lines(rows: Sequence[DensityRow]) -> list[str]:
    """Return the table of ratings with fewer points."""
    header = ("rating", "points per m2", "points kept", "still classified", "same class", "mean over classes")
    more = ("two or more off", "C_r relative to all points", "confidence if same class", "confidence if other class")
    return table(
        (*header, *more),
        [
            [
                f"`{row.rating}`",
                number(row.density),
                percent(row.share_of_points),
                percent(row.still_judged),
                percent(row.same_class),
                percent(row.same_by_class),
                percent(row.off_two),
                number(row.c_r_ratio),
                number(row.confidence_kept),
                number(row.confidence_moved),
            ]
            for row in rows
        ],
    )


def noise_lines(rows: Sequence[NoiseRow]) -> list[str]:
    """Return the table of ratings of noisy surveys compared with ground without noise."""
    header = ("points per m2", "noise [cm]", "C_r of dead-flat ground", "90 % quantile")
    more = (
        "noise left in",
        "median error, smooth third",
        "noise left in",
        "middle third",
        "noise left in",
        "rough third",
        "noise left in",
        "80 % interval holds",
    )
    return table(
        (*header, *more, "smooth / middle / rough", "tiles"),
        [
            [
                number(row.density, 4),
                number(100 * row.noise_m),
                number(row.flat),
                number(row.flat_worst),
                number(row.flat_raw),
                *(percent(value) for pair in zip(row.error, row.error_raw, strict=True) for value in pair),
                percent(row.held),
                " / ".join(map(percent, row.held_thirds)),
                str(row.tiles),
            ]
            for row in rows
        ],
    )


def move_lines(rows: Sequence[MoveRow]) -> list[str]:
    """Return the table of moved tiles compared with the tiles in place."""
    return table(
        ("rating", "tiles moved", "tiles", "same class", "median change of C_r"),
        [
            [f"`{row.rating}`", row.move, str(row.tiles), percent(row.same_class), percent(row.c_r_change)]
            for row in rows
        ],
    )


def timing_lines(rows: Sequence[StepCost]) -> list[str]:
    """Return the table of the cost of a tile, followed by the paper's Table II."""
    cells = [
        [row.step, f"{row.processor_ms:.4f}", number(row.peak_kb), number(row.result_kb), str(row.tiles)]
        for row in rows
    ]
    cells += [
        ["paper: heightmap method", f"{PAPER['heightmap_ms']}", _NONE, f"{PAPER['heightmap_kb']}", _NONE],
        ["paper: variance and residual from points", f"{PAPER['variance_and_residual_ms']}", _NONE, _NONE, _NONE],
    ]
    header = ("step", "CPU time [ms per patch]", "peak memory [kB per patch]", "result [kB per patch]", "patches")
    return table(header, cells)
