"""Write the reports of evaluations: Markdown and JSON."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

from bumpymap.core import CLASS_NAMES, atomic, plain_json
from bumpymap.lab.evaluate.agreement import Accuracy, Comparison
from bumpymap.lab.evaluate.scans import DEVIATION, RANGE_M, ScanFindings
from bumpymap.lab.evaluate.survey_trial import Findings

REPORT = "report.md"
_NONE = "-"


def write_document(
    out: Path, title: str, opening: Sequence[str], sections: Iterable[list[str]], record: dict[str, Any]
) -> list[Path]:
    """Write ``report.json``, nested records of numbers, strings and arrays with their ``format``, and ``report.md``."""
    lines = [f"# {title}", "", *opening, *(line for part in sections for line in part)]
    text = "\n".join(lines).rstrip() + "\n"
    content = json.dumps(plain_json(record, 6), indent=1, allow_nan=False) + "\n"
    files = [out / REPORT, out / "report.json"]
    for path, written in zip(reversed(files), (content, text), strict=True):
        with atomic(path) as temporary:
            temporary.write_text(written, encoding="utf-8")
    return files


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


def write_report(findings: Findings, out: Path) -> list[Path]:
    """Write ``report.json`` and ``report.md`` of a survey, in this order."""
    found = findings.comparison
    classes = [*class_lines(findings.classes), ""] if findings.classes else []
    sections = [
        section("Statistics of the classes", "The paper's Table I, over all classified tiles.", classes),
        section(f"Predicted and driven: {findings.vehicle['vehicle']}", _method(found), _driven(found)),
    ]
    opening = [*_opening(findings), *_conclusion(findings)]
    record = {"format": "bumpymap-evaluation", "version": 1, **asdict(findings)}
    return write_document(out, "Can the map be trusted?", opening, sections, record)


_PAPER_CLASSES = (
    ("paper, first site", (0.0039, 0.0329, 0.0952, 36.1), (0.0369, 0.0788, 0.1718, 3.62)),
    ("paper, second site", (0.0096, 0.0693, 0.1517, 0.6955), (0.036, 0.0961, 0.0932, 0.1759)),
)
"""The paper's Table I: variance [m2] and residual [m] of class 0 to 3."""
_PLAIN = ("z_variance", "ransac_residual", "slope_free_sd")


def _opening(findings: Findings) -> list[str]:
    facts = findings.facts
    points = "ground points only" if facts["ground_only"] else "all points"
    why = ", ".join(f"{name}: {count}" for name, count in facts["unknown_tiles"].items())
    unknown = f"{sum(facts['unknown_tiles'].values())} unknown" + (f" ({why})" if why else "")
    first = (
        f"Survey {', '.join(facts['files'])}: {facts['points']:,} points, measured from {points}; "
        f"{facts['judged_tiles']} tiles classified, {unknown}, "
        f"{facts['density']:.0f} points per m2 on the classified ones."
    )
    own = findings.vehicle
    limits, ratings = " / ".join(map(number, own["class_limits"])), ", ".join(f"`{name}`" for name in own["ratings"])
    row = [own["vehicle"], f"`{own['calibration']}`", limits, ratings]
    return [first, "", *table(("vehicle", "calibration", "class limits [rad/m]", "ratings"), [row])]


def _conclusion(findings: Findings) -> list[str]:
    """Summarise the comparison with the drives."""
    lines = [
        f"- **{findings.vehicle['vehicle']}, `{name}`**: C_r is off by {percent(own.median_error)} in the median; "
        f"{percent(own.coverage['held'])} of its 80 % intervals contain it; {percent(own.steps['same'])} of the "
        f"classes are the driven ones, {percent(own.steps['further'])} are off by two or more."
        for name, own in findings.comparison.agreement.items()
        if own.coverage and findings.comparison.patches > findings.comparison.left_out
    ]
    return [*lines, ""] if lines else []


def class_lines(classes: Mapping[str, dict[str, Any]]) -> list[str]:
    """Return Table I of each rating, followed by the paper's."""
    names = ("variance_median", "variance_mean", "residual_median", "residual_mean", "c_r_median")
    rows = [
        [rating, f"{row['class_id']} {CLASS_NAMES[row['class_id']]}", str(row["tiles"]), percent(row["share"])]
        + [number(row[name]) for name in names]
        for rating, found in classes.items()
        for row in found["rows"]
    ]
    for site, variance, residual in _PAPER_CLASSES:
        for class_id, (square, away) in enumerate(zip(variance, residual, strict=True)):
            rows.append([site, str(class_id), _NONE, _NONE, _NONE, number(square), _NONE, number(away), _NONE])
    header = ("rating", "class", "tiles", "share", "variance [m2], median", "mean", "residual [m], median", "mean")
    lines = table((*header, "C_r [rad/m], median"), rows)
    for rating, found in classes.items():
        # variance_median -> median variance
        falls = [" ".join(reversed(name.rsplit("_", 1))) for name, rises in found["rises"].items() if not rises]
        missing = [str(row["class_id"]) for row in found["rows"] if not row["tiles"]]
        order = "variance, residual and C_r rise from class to class, in median and mean."
        if falls:
            order = f"from class to class these do not rise everywhere: {', '.join(falls).replace('c_r', 'C_r')}."
        if len(found["rows"]) - len(missing) < 2:
            order = "fewer than two classes hold tiles, so nothing can rise from class to class."
        lines.append(f"- `{rating}`: {order}" + (f" No tile is of class {', '.join(missing)}." if missing else ""))
    return lines


def _driven(found: Comparison) -> list[str]:
    confusions = [
        line
        for name, own in found.agreement.items()
        if own.coverage
        for line in confusion_lines(name, own.confusion, "driven", "predicted")
    ]
    failures = [
        [f"`{name}`", number(one["predicted"]), number(one["share_failed"]), str(one["patches"])]
        for name, own in found.agreement.items()
        for one in (own.fail["reliability"] if own.fail else ())
        if one["patches"]
    ]
    return [
        *_predictor_lines(found),
        *_against_plain(found),
        *confusions,
        "Failed drives by predicted `p_fail`, in bins of width 0.2; all patches have the same weight:",
        "",
        *table(("rating", "mean p_fail of the bin", "share of drives that failed", "patches"), failures),
    ]


def _predictor_lines(found: Comparison) -> list[str]:
    """Return the table of all predictors compared with the drives."""
    rows = []
    for name, own in found.agreement.items():
        ranks = (f"{own.spearman:.4f}", f"{1 - own.spearman:.4f}") if math.isfinite(own.spearman) else (_NONE, _NONE)
        held = percent(own.coverage["held"]) if own.coverage else _NONE
        auc = [number(own.fail[kind]) if own.fail else _NONE for kind in ("auc", "auc_below_limit")]
        row = [
            f"`{name}`",
            *ranks,
            percent(own.median_error),
            number(own.median_ratio),
            *map(percent, own.steps.values()),
        ]
        rows.append([*row, held, *auc])
    header = ("predictor", "Spearman", "1 - Spearman", "median error", "median predicted / driven")
    more = ("same class", "one off", "two or more off", "80 % interval contains it", "p_fail AUC", "within slope limit")
    return table((*header, *more), rows)


def confusion_lines(name: str, confusion: Sequence[Sequence[int]], truth: str, found: str) -> list[str]:
    """Return a confusion matrix as a table; ``truth`` and ``found`` label its rows and columns, such as *driven*."""
    rows = [[f"{truth} {class_id}", *map(str, line)] for class_id, line in enumerate(confusion)]
    return table((f"`{name}`", *(f"{found} {class_id}" for class_id in range(len(rows)))), rows)


def _method(found: Comparison) -> str:
    bounds = ((found.auc_most, ""), (found.auc_most_below_limit, " within the slope limit"))
    most = ", or ".join(f"above {auc:.3f}{where}" for auc, where in bounds if math.isfinite(auc))
    return (
        f"{found.patches} patches, {found.drives} drives, {found.failed} of them failed. On {found.left_out} patches "
        "more than a quarter of the drives failed; their C_r, of the completed drives only, is not compared. The "
        f"standard error of the driven C_r is {percent(found.label_error)} in the median, and above 5 % on "
        f"{found.label_error_over} patches. "
        "Failures are compared on all patches, classes on those within the vehicle's slope limit: "
        f"{found.beyond_limit} are beyond it and have class 3 by definition. "
        + (f"As some drives over a patch fail and others do not, no p_fail can reach an AUC {most}. " if most else "")
        + "Plain predictors get C_r from their best monotone fit to the drives over the other patches, which a map "
        "does not have. The drives run on the measured relief and contain its noise; `ride` predicts the ground "
        "without noise."
    )


def _against_plain(found: Comparison) -> list[str]:
    lack = {name: 1 - own.spearman for name, own in found.agreement.items() if math.isfinite(own.spearman)}
    best = min((name for name in _PLAIN if name in lack), key=lambda name: lack[name], default=None)
    if best is None or lack[best] <= 0:
        return []
    ratios = [f"{lack[name] / lack[best]:.2f} times for `{name}`" for name in lack if name not in _PLAIN]
    return [f"1 - Spearman relative to that of the best plain predictor, `{best}`: {', '.join(ratios)}.", ""]


_PAPER_ACCURACY = 0.8324
_ANSWERS = (
    "A method is of use if it beats the constant answers in accuracy *and* in balanced accuracy (the mean of the "
    f"recalls). *{DEVIATION}* sets two limits on the standard deviation of z of all points of a sector, chosen to suit "
    "these very scans, which no method in use can do. The class of a sector's most frequent label counts as true."
)
_GROUND = (
    f"Points {RANGE_M[0]:g} to {RANGE_M[1]:g} m away, against the ground ids of the label set; points without a label "
    "are left out."
)
_OBSTACLES = (
    f"Points {RANGE_M[0]:g} to {RANGE_M[1]:g} m away with an obstacle's label. A sector is called free if its class is "
    "0 or 1 and no obstacle stands on it. *Low*: points not known to be higher than the vehicle, such as a crown."
)


def write_scan_report(findings: ScanFindings, out: Path) -> list[Path]:
    """Write ``report.json`` and ``report.md`` of scans, in this order."""
    facts = findings.facts
    opening = (
        f"{facts['scans']} scans, {facts['sectors']:,} sectors with ground, {facts['labelled']:,} of them labelled"
        + (f" (label set `{facts['labels']}`)" if facts["labels"] else "")
        + f". Filter method: centres at {', '.join(f'{centre:.2f}' for centre in facts['filter']['centres'])} stripes. "
        f"Learned method: network {facts['network']}."
    )
    ground = [
        [score["frame"], f"{score['points']:,}", *(percent(score[name]) for name in ("precision", "recall", "f1"))]
        for score in findings.ground
    ]
    obstacles = [
        [method, f"{score['points']:,}"]
        + [
            percent(score[name] / score["points"] if score["points"] else math.nan)
            for name in ("in_free", "in_free_low", "in_free_class")
        ]
        for method, score in findings.obstacles.items()
    ]
    free = ("method", "points", "in free sectors", "low", "in sectors of class 0 or 1")
    sections = [
        section("Compared with labels", _ANSWERS, _accuracy_lines(findings) if findings.accuracy else []),
        section("Ground", _GROUND, table(("frame", "points", "precision", "recall", "F1"), ground) if ground else []),
        section("Obstacles in sectors called free", _OBSTACLES, table(free, obstacles) if obstacles else []),
        section("Statistics of the classes", "The paper's Tables IV and V.", scan_class_lines(findings)),
    ]
    record = {"format": "bumpymap-scan-evaluation", "version": 1, **asdict(findings)}
    return write_document(out, "Can the classes of scans be trusted?", [opening, ""], sections, record)


def _accuracy_lines(findings: ScanFindings) -> list[str]:
    facts = findings.facts
    lines = [f"{facts['labelled']:,} sectors with ground:", "", *_answer_table(findings.accuracy)]
    lines += [f"All {facts['all_labelled']:,} sectors; to a method, one without ground is of class 2:", ""]
    lines += _answer_table(findings.accuracy_all)
    for method in findings.classes:
        lines += confusion_lines(method, findings.accuracy[method].confusion, "labelled", "found")
    return [*lines, f"The paper reports {percent(_PAPER_ACCURACY)} on its own patches of RELLIS-3D.", ""]


def _answer_table(answers: dict[str, Accuracy]) -> list[str]:
    rows = [[name, *map(percent, (found.right, found.even, *found.recall))] for name, found in answers.items()]
    return table(("answer", "accuracy", "balanced accuracy", "recall of 0", "of 1", "of 2"), rows)


def scan_class_lines(findings: ScanFindings) -> list[str]:
    """Return the paper's Tables IV and V of each method, and whether their figures are in order."""
    rows, summary = [], []
    for method, classes in findings.classes.items():
        for row in classes:
            values = (*row["stripes"], *row["variance"], *row["residual"])
            count = (str(row["class_id"]), str(row["sectors"]), percent(row["share"]))
            rows.append([method, *count, *map(number, values)])
        wrong = [
            f"{kind} {name}"
            for name, sign in (("stripes", -1), ("variance", 1), ("residual", 1))
            for place, kind in enumerate(("median", "mean"))
            if any(
                sign * (after[name][place] - before[name][place]) <= 0
                for before, after in pairwise(row for row in classes if row["sectors"])
            )
        ]
        order = (
            f"not in order from class to class: {', '.join(wrong)}"
            if wrong
            else "variance and residual rise from class to class and stripes fall, in median and mean"
        )
        summary.append(f"- `{method}`: {order}.")
    header = ("method", "class", "sectors", "share", "stripes, median", "mean", "variance [m2], median", "mean")
    return [*table((*header, "residual [m], median", "mean"), rows), *summary, ""]
