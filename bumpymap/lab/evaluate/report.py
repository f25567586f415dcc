"""Write the reports of evaluations: Markdown and JSON."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

from bumpymap.core import CLASS_NAMES, atomic, plain_json
from bumpymap.lab.evaluate.agreement import Accuracy
from bumpymap.lab.evaluate.scans import DEVIATION, RANGE_M, ScanFindings

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


_PAPER_CLASSES = (
    ("paper, first site", (0.0039, 0.0329, 0.0952, 36.1), (0.0369, 0.0788, 0.1718, 3.62)),
    ("paper, second site", (0.0096, 0.0693, 0.1517, 0.6955), (0.036, 0.0961, 0.0932, 0.1759)),
)
"""The paper's Table I: variance [m2] and residual [m] of class 0 to 3."""


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


def confusion_lines(name: str, confusion: Sequence[Sequence[int]], truth: str, found: str) -> list[str]:
    """Return a confusion matrix as a table; ``truth`` and ``found`` label its rows and columns, such as *driven*."""
    rows = [[f"{truth} {class_id}", *map(str, line)] for class_id, line in enumerate(confusion)]
    return table((f"`{name}`", *(f"{found} {class_id}" for class_id in range(len(rows)))), rows)


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
