"""Summary of ``evaluate --scans``: both methods beside the answers that need none."""

from typing import TYPE_CHECKING

from bumpymap.cli._text import print_line

if TYPE_CHECKING:
    from bumpymap.lab import ScanFindings

__all__ = ["summarise_scans"]


def summarise_scans(findings: "ScanFindings") -> None:
    """Print what an evaluation of scans found."""
    from bumpymap.lab import percent

    if findings.accuracy:
        print_line(f"{findings.facts['labelled']:,} labelled sectors with ground")
    for name, found in findings.accuracy.items():
        recalls = ", ".join(percent(recall) for recall in found.recall)
        print_line(
            f"  {name:14s} right {percent(found.right):>7s}   balanced {percent(found.even):>7s}   "
            f"recall of 0, 1, 2: {recalls}"
        )
    if findings.ground:
        mean = findings.ground[-1]
        print_line(
            f"ground of {mean.points:,} labelled points: precision {percent(mean.precision)}, recall "
            f"{percent(mean.recall)}, F1 {percent(mean.f1)}"
        )
    for name, score in findings.obstacles.items():
        if score.points:
            print_line(f"{name:8s} {percent(score.in_free / score.points)} of the points of obstacles in free sectors")
    for name, both in findings.sensors.items():
        if both.cells:
            print_line(f"{name:8s} {percent(both.same / both.cells)} of the cells in the same class by two sensors")
