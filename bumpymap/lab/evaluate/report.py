"""Write the report of an evaluation of scans: Markdown and JSON."""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path

from bumpymap.core import atomic, plain_json
from bumpymap.lab.evaluate.scans import DEVIATION, RANGE_M, ScanFindings
from bumpymap.lab.label_sets import Accuracy

REPORT = "report.md"
"""Name of the page of an evaluation."""


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return [*lines, *(f"| {' | '.join(row)} |" for row in rows), ""]


def number(value: float) -> str:
    """Format a number with three significant digits; a dash if it is not finite."""
    return f"{value:.3g}" if math.isfinite(value) else "-"


def percent(share: float) -> str:
    """Format a share of 0..1 as per cent; a dash if it is not finite."""
    return f"{100 * share:.1f} %" if math.isfinite(share) else "-"


_PAPER_ACCURACY = 0.8324
"""Of the learned method, on its patches of RELLIS-3D."""
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
        ("Compared with labels", _ANSWERS, _accuracy_lines(findings) if findings.accuracy else []),
        ("Ground", _GROUND, table(("frame", "points", "precision", "recall", "F1"), ground) if ground else []),
        ("Obstacles in sectors called free", _OBSTACLES, table(free, obstacles) if obstacles else []),
        ("Statistics of the classes", "The paper's Tables IV and V.", scan_class_lines(findings)),
    ]
    lines = ["# Can the classes of scans be trusted?", "", opening, ""]
    for title, intro, own in sections:
        lines += [f"## {title}", "", intro, "", *own] if own else []
    record = {"format": "bumpymap-scan-evaluation", "version": 1, **asdict(findings)}
    files = {
        out / "report.json": json.dumps(plain_json(record, 6), indent=1, allow_nan=False) + "\n",
        out / REPORT: "\n".join(lines).rstrip() + "\n",
    }
    for path, text in files.items():
        with atomic(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return list(files)


def _accuracy_lines(findings: ScanFindings) -> list[str]:
    facts = findings.facts
    lines = [f"{facts['labelled']:,} sectors with ground:", "", *_answer_table(findings.accuracy)]
    lines += [f"All {facts['all_labelled']:,} sectors; to a method, one without ground is of class 2:", ""]
    lines += _answer_table(findings.accuracy_all)
    for method in findings.classes:
        rows = [[f"labelled {k}", *map(str, line)] for k, line in enumerate(findings.accuracy[method].confusion)]
        lines += table((f"`{method}`", *(f"found {k}" for k in range(len(rows)))), rows)
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
