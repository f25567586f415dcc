"""Write report.html, one file that requests nothing: as a view of a run that is ending, or again for its layers."""

import os
from collections.abc import Iterator, Mapping, Sequence
from os.path import lexists
from pathlib import Path
from typing import Any

from bumpymap.core import (
    BARRED_TEXT,
    CLASS_NAMES,
    OBJECT_NAMES,
    REASON_TEXT,
    BadInputError,
    Barred,
    CheckResult,
    OutputError,
    Reason,
    UsageError,
    atomic,
    utf8_path,
)
from bumpymap.layers.check.vectors import CheckGround
from bumpymap.layers.check.words import check_headline, names_of
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS, OBJECT_COLOURS, OFF_COLOURS
from bumpymap.layers.manifest import MANIFEST_NAME, read_manifest
from bumpymap.layers.map_files import require_map_written, require_written
from bumpymap.layers.products import REPORT_NAME
from bumpymap.layers.report.change_page import is_comparison, read_comparison, write_change_report
from bumpymap.layers.report.drives import DrawnCheck, drive_figures, read_drawn_check, reading_notes
from bumpymap.layers.report.map_figure import RAMP, map_figure
from bumpymap.layers.report.markup import Html, document, join, section, tag
from bumpymap.layers.report.sections import (
    drive_section,
    ground_section,
    lettered,
    limit_section,
    repeat_section,
    sheet_section,
    summary_line,
    survey_section,
    vehicle_section,
    way_section,
)
from bumpymap.layers.report.site import Site, read_ways
from bumpymap.layers.report.tiles import UNKNOWN_FROM
from bumpymap.layers.report.words import headline

__all__ = ["render", "write_check_page", "write_report", "write_reports"]


def render(sites: Sequence[Site]) -> str:
    """Return the page of one map, or of two side by side, as HTML.

    It holds everything that it shows; its policy forbids a browser to fetch anything else. The same layers give the
    same page: it holds no time and no folder.
    """
    name = " and ".join(site.name for site in sites)
    shared = _same_place(sites)
    data = {"maps": [site.map_record() for site in sites], "together": shared, "codes": _codes()}
    sections = [
        tag(
            "section",
            tag("h2", "Maps" if len(sites) > 1 else "Map", id="map"),
            tag("p", "Both maps move together and show the same layers." if shared else "", class_="note")
            if len(sites) > 1
            else "",
            tag("div", *_figures(sites), class_="beside maps"),
            *_to_sheets(sites),
            aria_labelledby="map",
        ),
        drive_section(sites),
        way_section(sites),
        ground_section(sites),
        sheet_section(sites),
        vehicle_section(sites),
        limit_section(sites),
        survey_section(sites),
        repeat_section(sites),
    ]
    return document(f"{name}: ground roughness", _headings(sites, name), sections, data)


def _to_sheets(sites: Sequence[Site]) -> list[Html]:
    """Return a line that leads to the table of sheets, if they have pages that can be opened from this one."""
    if not any(site.has_links and site.record.get("sheets") for site in sites):
        return []
    return [tag("p", "Each of ", tag("a", "the sheets", href="#sheets"), " has a page that shows it larger.")]


def _headings(sites: Sequence[Site], name: str) -> list[Html]:
    if len(sites) == 1:
        (site,) = sites
        lines = [tag("p", headline(site), class_="result"), tag("p", summary_line(site), class_="facts")]
    else:
        lines = [
            tag("p", tag("strong", f"{letter}, {site.name}: "), headline(site), class_="result small")
            for letter, site in lettered(sites)
        ]
        lines += [tag("p", f"{letter}: {summary_line(site)}", class_="facts") for letter, site in lettered(sites)]
    kind = "Ground roughness" if len(sites) == 1 else "Ground roughness, two maps compared"
    return [tag("p", kind, class_="kind"), tag("h1", name), join(*lines)]


def write_check_page(result: CheckResult, ground: CheckGround | None, path: Path) -> None:
    """Write check.html: the drives over the map they were checked against, charts, tables, how to read them.

    Without a map, or where its layers cannot be drawn, the page has no map.

    Parameters
    ----------
    result : CheckResult
    ground : CheckGround or None
        The map; None without one.
    path : Path
        The file, which appears only when it is complete.

    Raises
    ------
    OutputError
        The page cannot be written.
    """
    check = DrawnCheck(result, is_of_this_run=True)
    sites = [] if ground is None else list(_driven_sites(check, ground))[:_MOST]
    about = result.ground
    names = names_of([drive.name for drive in result.drives])
    title = f"Drives measured: {names}" if about is None else f"{about.name} checked against {names}"
    header = [tag("p", "Ride cost by real drives", class_="kind"), tag("h1", title)]
    header.append(tag("p", check_headline(result), class_="result"))
    if about is not None:
        limits = ", ".join(f"{limit:.3g}" for limit in about.class_limits)
        facts = (
            f"Map: vehicle {about.vehicle}, calibration {about.calibration_id}, driven at {about.speed_mps:g} m/s, "
            f"limits of the classes {limits} rad/m"
        )
        header.append(tag("p", facts, class_="facts"))
    sections = [
        section("Map", "map", tag("div", *_figures(sites), class_="beside maps")) if sites else Html(),
        section("Drives", "drives", drive_figures(check, "check")),
        section("How to read this", "read", reading_notes(result)),
    ]
    data = {"maps": [site.map_record() for site in sites], "together": _same_place(sites), "codes": _codes()}
    text = document(title, header, sections, data, source="the drives and layers that check.json names")
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _driven_sites(check: DrawnCheck, ground: CheckGround) -> Iterator[Site]:
    """Yield the maps with a stretch on them, as far as they can be drawn."""
    stretches = check.result.stretches
    for folder, record in zip(ground.folders, ground.manifests, strict=False):
        try:
            with utf8_path(folder) as readable:
                site = Site.read(readable, record, maps=min(_MOST, len(ground.folders)), has_links=False, check=check)
        except BadInputError:
            continue
        spot = site.tiles.spot
        east, south = stretches.easting - spot.west, spot.north - stretches.northing
        inside = (east >= 0) & (east < spot.cols * spot.tile_size) & (south >= 0) & (south < spot.rows * spot.tile_size)
        if inside.any():
            yield site


def _figures(sites: Sequence[Site]) -> list[Html]:
    return [map_figure(site, at, letter) for at, (letter, site) in enumerate(lettered(sites))]


def _same_place(sites: Sequence[Site]) -> bool:
    """Return whether maps overlap in one CRS, so that they can move together."""
    if len(sites) < 2 or len({site.crs_name for site in sites}) > 1:
        return False
    boxes = [
        (spot.west, spot.north - spot.rows * spot.tile_size, spot.west + spot.cols * spot.tile_size, spot.north)
        for spot in (site.tiles.spot for site in sites)
    ]
    (west, south, east, north), (left, low, right, high) = boxes
    return west < right and left < east and south < high and low < north


def _codes() -> dict[str, object]:
    """Return names and colours of the codes in the grids."""
    return {
        "unknownFrom": UNKNOWN_FROM,
        "notKnown": int(Barred.UNKNOWN),
        "classes": list(CLASS_NAMES),
        "reasons": [REASON_TEXT[code] for code in Reason],
        "barred": [BARRED_TEXT[code] for code in Barred],
        "objects": list(OBJECT_NAMES),
        "classColours": [CLASS_COLOURS[code] for code in range(len(CLASS_NAMES))],
        "barredColours": [BARRED_COLOURS[code] for code in Barred],
        "objectColours": [OBJECT_COLOURS[code] for code in range(len(OBJECT_NAMES))],
        "offColours": [OFF_COLOURS[code] for code in range(len(OFF_COLOURS))],
        "ramp": RAMP,
    }


_MOST = 2
"""Maps that a page can show."""
_SUFFIXES = {".html", ".htm"}
_READ = ("class.tif", "heightmap.tif", "obstacle.tif", "tiles.parquet")


def write_report(folder: Path, record: Mapping[str, Any]) -> None:
    """Write report.html to a folder of complete layers.

    Parameters
    ----------
    folder : Path
        The layers.
    record : mapping
        The content of run.json, which need not be there yet.

    Raises
    ------
    BadInputError
        A layer cannot be read.
    OutputError
        The page cannot be written.
    """
    _write([Site.read(folder, record)], folder / REPORT_NAME)


def write_reports(
    layers: Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str] | None = None,
    *,
    route: str | os.PathLike[str] | None = None,
    check: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the page of one map or one comparison again, or one page that shows two maps side by side.

    Parameters
    ----------
    layers : sequence of path
        One or two folders that `bumpymap map` wrote, or one that `bumpymap diff` wrote.
    out : path, optional
        The file; default is report.html in the folder of the layers, which is replaced, since it can be made again.
    route : path, optional
        A folder that `bumpymap route` wrote: its ways are drawn.
    check : path, optional
        A folder that `bumpymap check` wrote for one of the maps: its drives are drawn, with what they say of the map.
    overwrite : bool
        Replace ``out`` if it exists.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    UsageError
        No layers or more than two, two without ``out``, or ``out`` is not named like a page; a comparison beside
        another folder, with ``route`` or with ``check``.
    BadInputError
        A folder holds no complete layers, or they cannot be read, ``route`` holds no way, or ``check`` is not that of
        one of the maps.
    OutputError
        The page cannot be written, or exists.
    """
    folders = [Path(folder) for folder in layers]
    if not 1 <= len(folders) <= _MOST:
        raise UsageError(f"{len(folders)} folders of layers given; a report shows one, or compares two")
    if out is None and len(folders) > 1:
        raise UsageError("a page that compares two maps belongs to neither folder: name the file with `out`")
    path = folders[0] / REPORT_NAME if out is None else Path(out)
    if any(map(is_comparison, folders)):
        asked = [name for name, given in (("route", route), ("check", check)) if given is not None]
        return _write_comparison(folders, path, asked, replace=overwrite or out is None)
    records = [read_manifest(folder) for folder in folders]
    _check(path, replace=overwrite or out is None)
    sites = []
    checks = _checks(check, folders, records)
    try:
        for folder, record, drives in zip(folders, records, checks, strict=True):
            require_map_written(folder, record, _READ)
            ways = () if route is None else read_ways(Path(route), record)
            with utf8_path(folder) as readable:
                beside = len(folders) == 1 and path.parent.resolve() == folder.resolve()
                sites.append(Site.read(readable, record, ways, maps=len(folders), has_links=beside, check=drives))
        _write(sites, path)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        named = " or ".join(str(folder / MANIFEST_NAME) for folder in folders)
        raise BadInputError(f"{named} is not that of a map of this version: {error!r}. Map the survey again") from error
    return path


def _check(path: Path, *, replace: bool) -> None:
    """Refuse, before anything is read, what cannot be written. A link is replaced as a link, never followed."""
    if path.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"{path} is not named like a page. Give a file that ends in .html as `out`")
    if path.is_dir() and not path.is_symlink():
        raise OutputError(f"cannot write {path}: it is a folder. Name a file with `out`, such as {path / REPORT_NAME}")
    if not path.parent.is_dir():
        raise OutputError(f"cannot write {path}: there is no folder {path.parent}. Create it, or choose another `out`")
    if lexists(path) and not replace:
        raise OutputError(f"{path} exists. Choose another `out`, or pass `overwrite=True` to replace it")


def _checks(
    check: str | os.PathLike[str] | None, folders: Sequence[Path], records: Sequence[Mapping[str, Any]]
) -> list[DrawnCheck | None]:
    """Return the drives over each map; of two maps, those of a check are of one at least."""
    if check is None:
        return [None] * len(folders)
    found: list[DrawnCheck | None] = []
    refused: list[BadInputError] = []
    for folder, record in zip(folders, records, strict=True):
        try:
            found.append(read_drawn_check(Path(check), record, folder))
        except BadInputError as error:
            found.append(None)
            refused.append(error)
    if len(refused) == len(folders):
        raise refused[0]
    return found


def _write_comparison(folders: Sequence[Path], path: Path, asked: Sequence[str], *, replace: bool) -> Path:
    if len(folders) > 1:
        found = next(folder for folder in folders if is_comparison(folder))
        raise UsageError(f"{found} holds a comparison of two surveys, which has a page of its own: give it alone")
    if asked:
        raise UsageError(f"`{asked[0]}` is drawn on the page of a map; this folder holds a comparison of two surveys")
    (folder,) = folders
    record = read_comparison(folder)
    _check(path, replace=replace)
    require_written(folder, record, ("change.tif", "change.geojson"), "change.json")
    try:
        with utf8_path(folder) as readable:
            write_change_report(readable, record, path)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise BadInputError(f"{folder / 'change.json'} is damaged: {error!r}. Compare the surveys again") from error
    return path


def _write(sites: Sequence[Site], path: Path) -> None:
    text = render(sites)
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
