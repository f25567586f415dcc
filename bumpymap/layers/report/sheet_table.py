"""The sheets of a map that is written in sheets, each with a link to its own page."""

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

from bumpymap.core import count_text
from bumpymap.layers.products import REPORT_NAME, SHEET_TABLE_NAME
from bumpymap.layers.report.markup import Html, join, table, tag
from bumpymap.layers.report.numbers import area, share, whole
from bumpymap.layers.report.site import Site

__all__ = ["sheet_table"]

_MOST = 500
"""Rows of the table: 10,000 of them would take more room than the maps."""
_METRES = 1000.0
"""Sides below are given in metres."""
_HEAD = ("sheet", "area", "passable", "not known", "points", "west", "south")


def sheet_table(site: Site) -> Html:
    """Return a table of the sheets, ordered by name; empty for a map in one folder."""
    sheets = site.record.get("sheets") or []
    if not sheets:
        return Html()
    shown = sheets[:_MOST]
    side = float(site.record["sheet_side_m"])
    size = f"{side:g} m" if side < _METRES else f"{side / 1000:g} km"
    about = f"The layers are in {count_text(len(sheets), 'sheet')} of {size}, each a folder with a page of its own."
    listed = "every sheet" if len(shown) == len(sheets) else f"all of them; the table below the first {whole(_MOST)}"
    file = tag("a", SHEET_TABLE_NAME, href=SHEET_TABLE_NAME) if site.has_links else SHEET_TABLE_NAME
    return join(
        tag("p", about, " ", file, f" lists {listed}."),
        table("Sheets", _HEAD, [_row(site, sheet) for sheet in shown], wide=True),
    )


def _row(site: Site, sheet: Mapping[str, Any]) -> tuple[str, ...]:
    folder, tiles = str(sheet["folder"]), int(sheet["tiles"])
    name = PurePosixPath(folder).name
    west, south, _, _ = sheet["bounds"]
    return (
        tag("a", name, href=f"{folder}/{REPORT_NAME}") if site.has_links else name,
        area(tiles * site.tile_area),
        share(sheet["passable"], tiles),
        share(sheet["unknown"], tiles),
        whole(int(sheet["points"])),
        f"{west:,.0f}",
        f"{south:,.0f}",
    )
