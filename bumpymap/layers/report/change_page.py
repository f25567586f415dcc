"""Write the page of what has changed between two surveys."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bumpymap.core import CHANGE_KINDS, BadInputError, Each, Nullable, Number, atomic, read_record, shape_fault
from bumpymap.layers.colours import CHANGE_COLOURS
from bumpymap.layers.manifest import COUNT, PLACE_SHAPE
from bumpymap.layers.report.change_figure import DIFFERENCE_RAMP, change_figure
from bumpymap.layers.report.change_sections import (
    change_headline,
    class_section,
    kind_section,
    limits_section,
    place_section,
    settings_section,
    surveys_section,
    titles,
)
from bumpymap.layers.report.change_site import NOT_COMPARED, ChangeSite
from bumpymap.layers.report.document import document
from bumpymap.layers.report.markup import tag

__all__ = ["is_comparison", "read_comparison", "write_change_report"]

_MANIFEST, _FORMAT = "change.json", "bumpymap-change"
_SIDE = {"folders": [str], "runs": [Each()]}
_SHAPE = PLACE_SHAPE | {
    "settings": {"fdr": Number(0, 1), "min_tiles": COUNT},
    "sources": {"before": _SIDE, "after": _SIDE},
    "vehicle": str,
    "calibration": str,
    "fit": {
        "widened": Each(Number()),
        "median_density_m2": (Nullable(Number()),) * 2,
        "versions": (Nullable(str),) * 2,
        "offset_taken_off_m": Number(),
        "offset_m": Nullable(Number()),
    },
    "counts": {
        **dict.fromkeys(("in_both", "compared", "changed", "regions", "passable_lost", "passable_won"), COUNT),
        "dropped_as_too_small": COUNT,
        "by_change": Each(COUNT),
    },
    "classes": {"names": [str], "tiles_before_after": [[COUNT]]},
    "remarks?": [str],
}


def is_comparison(folder: Path) -> bool:
    """Return whether a folder holds what `bumpymap diff` wrote, and not the layers of a map."""
    return (folder / _MANIFEST).is_file() and not (folder / "run.json").exists()


def read_comparison(folder: Path) -> dict[str, Any]:
    """Read change.json. Raises BadInputError if it is damaged."""
    record = read_record(folder / _MANIFEST)
    if record is None or record.get("format") != _FORMAT:
        raise BadInputError(f"{folder / _MANIFEST} is not that of a comparison. Compare the surveys again")
    if fault := shape_fault(record, _SHAPE):
        raise BadInputError(f"{folder / _MANIFEST} is damaged: {fault}. Compare the surveys again")
    return record


def write_change_report(folder: Path, record: Mapping[str, Any], path: Path) -> None:
    """Write the page of the changes in a folder.

    Parameters
    ----------
    folder : Path
        change.tif and change.geojson.
    record : mapping
        The content of change.json, which need not be there yet.
    path : Path
        The page.

    Raises
    ------
    BadInputError
        A file cannot be read.
    OutputError
        The page cannot be written.
    """
    text = render_changes(ChangeSite.read(folder, record))
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def render_changes(site: ChangeSite) -> str:
    """Return the page as HTML. The same changes give the same page: it holds no time and no folder."""
    before, after = titles(site)
    name = f"{before} to {after}"
    header = [
        tag("p", "What has changed between two surveys", class_="kind"),
        tag("h1", name),
        tag("p", change_headline(site), class_="result"),
        tag("p", f"vehicle {site.record['vehicle']} · {site.crs_name}", class_="facts"),
    ]
    sections = [
        tag("section", tag("h2", "Map", id="map"), change_figure(site, name), aria_labelledby="map"),
        place_section(site),
        kind_section(site),
        class_section(site),
        surveys_section(site),
        settings_section(site),
        limits_section(site),
    ]
    codes = {
        "unknownFrom": NOT_COMPARED,
        "classes": list(CHANGE_KINDS),
        "reasons": ["not compared: may have changed or not"],
        "outside": "outside of what the surveys share: not compared",
        "classColours": [CHANGE_COLOURS[code] for code in range(len(CHANGE_KINDS))],
        "ramp": DIFFERENCE_RAMP,
    }
    data = {"maps": [site.map_record()], "together": False, "codes": codes}
    return document(f"{name}: what has changed", header, sections, data)
