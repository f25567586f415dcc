"""Write the report of an evaluation of scans: Markdown and JSON."""

import math
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

from bumpymap.lab.evaluate.report import confusion_lines, number, percent, report_text, section, table, write_document
from bumpymap.lab.evaluate.scans import DEVIATION, RANGE_M, Accuracy, ScanClassRow, ScanFindings

__all__ = ["write_scan_report"]

_PAPER_ACCURACY = 0.8324


def write_scan_report(findings: ScanFindings, out: Path) -> list[Path]:
    """Write ``report.json`` and ``report.md``, in this order."""
    return write_document(out, scan_markdown(findings), "bumpymap-scan-evaluation", asdict(findings))


def scan_markdown(findings: ScanFindings) -> str:
    """Return the text of the report."""
    sections = [
        section("Compared with labels", _ANSWERS, _accuracy_lines(findings) if findings.accuracy else []),
        section("Ground", _GROUND, _ground_lines(findings) if findings.ground else []),
        section(
            "Obstacles in sectors called free", _OBSTACLES, _obstacle_lines(findings) if findings.obstacles else []
        ),
        section("Statistics of the classes", "The paper's Tables IV and V.", _class_lines(findings)),
    ]
    return report_text("Can the classes of scans be trusted?", [_opening(findings.facts), ""], sections)


def _opening(facts: dict[str, Any]) -> str:
    centres = ", ".join(f"{centre:.2f}" for centre in facts["filter"]["centres"])
    return (
        f"{facts['scans']} scans, {facts['sectors']:,} sectors with ground, {facts['labelled']:,} of them "
        f"labelled{_set_name(facts)}. Filter method: centres at {centres} stripes. Learned method: network "
        f"{facts['network']}."
    )


def _set_name(facts: dict[str, Any]) -> str:
    return f" (label set `{facts['labels']}`)" if facts["labels"] else ""


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


def _class_lines(findings: ScanFindings) -> list[str]:
    rows = []
    for method, classes in findings.classes.items():
        for row in classes:
            values = (*row.stripes, *row.variance, *row.residual)
            rows.append([method, str(row.class_id), str(row.sectors), percent(row.share), *map(number, values)])
    header = ("method", "class", "sectors", "share", "stripes, median", "mean", "variance [m2], median", "mean")
    summary = [f"- {_order(name, rows_)}" for name, rows_ in findings.classes.items()]
    return [*table((*header, "residual [m], median", "mean"), rows), *summary, ""]


def _order(method: str, rows: list[ScanClassRow]) -> str:
    """Describe whether measures rise and stripes fall from class to class, skipping classes without sectors."""
    there = [row for row in rows if row.sectors]
    wrong = [
        f"{kind} {name}"
        for name, sign in (("stripes", -1), ("variance", 1), ("residual", 1))
        for place, kind in enumerate(("median", "mean"))
        if any(
            sign * (getattr(after, name)[place] - getattr(before, name)[place]) <= 0
            for before, after in pairwise(there)
        )
    ]
    if not wrong:
        return f"`{method}`: variance and residual rise from class to class and stripes fall, in median and mean."
    return f"`{method}`: not in order from class to class: {', '.join(wrong)}."


def _accuracy_lines(findings: ScanFindings) -> list[str]:
    facts = findings.facts
    lines = [f"{facts['labelled']:,} sectors with ground:", "", *_answer_table(findings.accuracy)]
    lines += [f"All {facts['all_labelled']:,} sectors; to a method, one without ground is of class 2:", ""]
    lines += _answer_table(findings.accuracy_all)
    for method in findings.classes:
        lines += confusion_lines(method, findings.accuracy[method].confusion, "labelled", "found")
    return [*lines, f"The paper reports {percent(_PAPER_ACCURACY)} on its own patches of RELLIS-3D.", ""]


def _answer_table(answers: dict[str, Accuracy]) -> list[str]:
    rows = [
        [name, percent(found.right), percent(found.even), *map(percent, found.recall)]
        for name, found in answers.items()
    ]
    return table(("answer", "accuracy", "balanced accuracy", "recall of 0", "of 1", "of 2"), rows)


def _ground_lines(findings: ScanFindings) -> list[str]:
    rows = [
        [score.frame, f"{score.points:,}", *(percent(value) for value in (score.precision, score.recall, score.f1))]
        for score in findings.ground
    ]
    return table(("frame", "points", "precision", "recall", "F1"), rows)


def _obstacle_lines(findings: ScanFindings) -> list[str]:
    rows = [
        [
            method,
            f"{score.points:,}",
            *(
                percent(part / score.points if score.points else math.nan)
                for part in (score.in_free, score.in_free_low, score.in_free_class)
            ),
        ]
        for method, score in findings.obstacles.items()
    ]
    return table(("method", "points", "in free sectors", "low", "in sectors of class 0 or 1"), rows)
