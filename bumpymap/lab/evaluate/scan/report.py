"""Write the report of an evaluation of scans: Markdown and JSON."""

import math
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

from bumpymap.lab.evaluate.document import number, percent, report_text, section, table, write_document
from bumpymap.lab.evaluate.scan.class_stats import ScanClassRow
from bumpymap.lab.evaluate.scan.run import ScanFindings
from bumpymap.lab.evaluate.scan.timing import PAPER_SECTOR_MS
from bumpymap.lab.evaluate.tables import confusion_lines

__all__ = ["scan_markdown", "write_scan_report"]

_PAPER_ACCURACY = 0.8324


def write_scan_report(findings: ScanFindings, out: Path) -> list[Path]:
    """Write ``report.json`` and ``report.md``, in this order."""
    return write_document(out, scan_markdown(findings), "bumpymap-scan-evaluation", asdict(findings))


def scan_markdown(findings: ScanFindings) -> str:
    """Return the text of the report."""
    sections = [
        section("Statistics of the classes", "The paper's Tables IV and V.", _class_lines(findings)),
        section("Compared with labels", "", _accuracy_lines(findings) if findings.accuracy else []),
        section("Rotated scans", _TURNED, _turned_lines(findings)),
        section("What a scan costs", _COSTS, _cost_lines(findings)),
    ]
    return report_text("Can the classes of scans be trusted?", [_opening(findings.facts), ""], sections)


def _opening(facts: dict[str, Any]) -> str:
    centres = ", ".join(f"{centre:.2f}" for centre in facts["filter"]["centres"])
    return (
        f"{facts['scans']} scans, {facts['sectors']:,} traversable sectors, {facts['labelled']:,} of them "
        f"labelled. Filter method: centres at {centres} stripes. Learned method: network {facts['network']}."
    )


_TURNED = "Share of the points that keep their class if the scan is rotated about z by random angles."
_COSTS = (
    "From points in memory to classified sectors, medians; times per sector are CPU times. *Plain* is the filter "
    "method implemented sector by sector with scikit-learn, SciPy and scikit-image, timed in the same run."
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
    rows = [
        [method, percent(found.right), percent(found.even), percent(_PAPER_ACCURACY) if method == "learned" else "-"]
        for method, found in findings.accuracy.items()
    ]
    lines = table(("method", "accuracy", "balanced accuracy", "the paper's, on RELLIS-3D"), rows)
    for method, found in findings.accuracy.items():
        lines += confusion_lines(method, found.confusion, "labelled", "found")
    return lines


def _turned_lines(findings: ScanFindings) -> list[str]:
    rows = [[method, percent(mean), percent(least)] for method, (mean, least) in findings.kept.items()]
    return table(("method", "mean over the scans", "minimum over the scans"), rows)


def _cost_lines(findings: ScanFindings) -> list[str]:
    plain = findings.plain.sector_ms if findings.plain else math.nan
    rows = [
        [
            cost.method,
            f"{cost.points:,}",
            str(cost.sectors),
            number(cost.scan_ms),
            number(cost.processor_ms),
            number(cost.sector_ms),
            number(cost.peak_mb),
            number(PAPER_SECTOR_MS[cost.method]),
            number(plain / cost.sector_ms) if cost.method == "filter" else "-",
        ]
        for cost in findings.costs
    ]
    header = ("method", "points", "sectors", "scan [ms]", "CPU [ms]", "per sector [ms]", "peak memory [MB]")
    more = ("the paper's per sector [ms]", "plain / ours")
    note = f"Plain: {number(plain)} ms per sector over {findings.plain.sectors} sectors." if findings.plain else ""
    return [*table((*header, *more), rows), note, ""]
