"""The section of a page on real drives over its map."""

from bumpymap.core import CheckResult
from bumpymap.layers.check.words import (
    AGREEMENT_HEAD,
    WORST_HEAD,
    agreement_rows,
    check_headline,
    drive_notes,
    drive_rows,
    left_out_rows,
    warnings_of,
    worst_rows,
)
from bumpymap.layers.report.charts import lines_of
from bumpymap.layers.report.drive_chart import drive_chart
from bumpymap.layers.report.drives import DrawnCheck
from bumpymap.layers.report.markup import Html, join, table, tag

__all__ = ["drive_figures"]

_AGAIN = "The layers were written again after this check: check them again for figures of this map."
_OFF = "Stretches that are off by more than the map's interval and the errors of measurement explain"


def drive_figures(check: DrawnCheck, key: str) -> Html:
    """Return what drives say of one map: in words, by class, stretch by stretch, and the drives themselves.

    Parameters
    ----------
    check : DrawnCheck
    key : str
        Makes ids on the page differ.
    """
    result = check.result
    worst = worst_rows(result)
    return join(
        tag("p", check_headline(result)),
        Html() if check.is_of_this_run else tag("p", tag("strong", _AGAIN)),
        _warnings(result),
        drive_chart(result, f"drives-{key}"),
        table("Map against drives", AGREEMENT_HEAD, agreement_rows(result), wide=True),
        table(_OFF, WORST_HEAD, worst, wide=True) if worst else Html(),
        _details(result),
    )


def _warnings(result: CheckResult) -> Html:
    found = warnings_of(result)
    return join(tag("h3", "Warnings"), lines_of(*found)) if found else Html()


def _details(result: CheckResult) -> Html:
    names = [drive.name for drive in result.drives]
    rows, left = drive_rows(result.drives), left_out_rows(result)
    return tag(
        "details",
        tag("summary", "The drives and their sensors"),
        table("The drives", ("figure", *names), rows, texts=1 + len(names), wide=len(names) > 1),
        lines_of(*drive_notes(result)),
        table("Parts of the ways that do not count", ("why", "way"), left) if left else Html(),
    )
