"""The page of a map, or of two side by side, and of drives over a map: as a view of a run that is ending, or again."""

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from os.path import lexists
from pathlib import Path, PurePosixPath
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
    utf8_path,
)
from bumpymap.layers import (
    BARRED_COLOURS,
    CLASS_COLOURS,
    LITTLE_SEEN,
    MANIFEST_NAME,
    OBJECT_COLOURS,
    OFF_COLOURS,
    REPORT_NAME,
    SHEET_TABLE_NAME,
    CheckGround,
    read_manifest,
    require_map_written,
    require_written,
)
from bumpymap.views.page.change_page import is_comparison, read_comparison, write_change_report
from bumpymap.views.page.drives import DrawnCheck, read_drawn_check
from bumpymap.views.page.page import write_page
from bumpymap.views.page.site import WAY_FIGURES, DrawnWay, Site, read_ways
from bumpymap.views.page.tiles import UNKNOWN_FROM
from bumpymap.views.words import (
    DASH,
    area,
    base_name,
    command_of,
    degrees,
    names_of,
    number,
    read_surfaces,
    settings_of,
    share,
    shares,
    whole,
)

__all__ = ["write_check_page", "write_maps", "write_report", "write_reports"]

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
    write_maps([Site.read(folder, record)], folder / REPORT_NAME)


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
        write_maps(sites, path)
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


def write_maps(sites: Sequence[Site], path: Path) -> None:
    """Write the page of one map, or of two. The same layers give the same page: it holds no time and no folder."""
    sites, real = _lettered(sites), read_surfaces()
    write_page(
        path,
        "map.html",
        name=" and ".join(site.name for site in sites),
        SHEET_TABLE_NAME=SHEET_TABLE_NAME,
        MOST_SHEETS=_MOST_SHEETS,
        bar_rows=_bar_rows,
        class_rows=_class_rows,
        command_of=command_of,
        compared=_compared,
        crossed=_crossed,
        file_rows=_file_rows,
        real=real,
        reason_rows=_reason_rows,
        settings_of=settings_of,
        sheet_rows=_sheet_rows,
        surface_rows=[(name, f"{c_r:.3f}", degrees(c_r)) for name, c_r in real["c_r"].items()],
        warnings_of=_warnings_of,
        way_rows=_way_rows,
        **_of_maps(sites),
    )


def _of_maps(sites: Sequence[Site]) -> dict[str, Any]:
    """Return what the figures of maps, and of drives over them, need; with the data of the script."""
    together = _same_place(sites)
    return {
        "maps": sites,
        "together": together,
        "ramp_colours": _RAMP,
        "data": {"maps": [site.map_record() for site in sites], "together": together, "codes": _CODES},
    }


def _lettered(sites: Sequence[Site]) -> list[Site]:
    """Return the maps with the letters by which the page names them; a single one needs none."""
    return [replace(site, letter=letter) for letter, site in zip("AB", sites, strict=False)] if sites[1:] else [*sites]


def _same_place(sites: Sequence[Site]) -> bool:
    """Return whether maps overlap in one CRS, so that they can move together."""
    if len(sites) < 2 or len({site.crs_name for site in sites}) > 1:
        return False
    one, other = (site.tiles.spot for site in sites)
    across = one.west < other.west + other.cols * other.tile_size and other.west < one.west + one.cols * one.tile_size
    down = one.north > other.north - other.rows * other.tile_size and other.north > one.north - one.rows * one.tile_size
    return across and down


_RAMP = ("#fcfdbf", "#feca8d", "#fd9668", "#f1605d", "#cd4071", "#9e2f7f", "#721f81", "#440f76", "#180f3d")
"""Colours from the least to the most of a value: lightness falls evenly, so that they can be told apart in grey."""
_CODES = {
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
    "ramp": _RAMP,
}
"""Names and colours of the codes in the grids."""


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
    sites = _lettered([] if ground is None else list(_driven_sites(check, ground))[:_MOST])
    names = names_of([drive.name for drive in result.drives])
    title = f"{result.ground.name} checked against {names}" if result.ground else f"Drives measured: {names}"
    write_page(path, "check.html", title=title, check=check, **_of_maps(sites))


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


def _crossed(site: Site) -> dict[str, str]:
    """Return the shares of the headline, empty where there is no such ground."""
    summary = site.summary
    parts = (summary.passable, summary.unknown, summary.tiles - summary.passable - summary.unknown)
    passable, unknown, barred = shares(parts, (0, 1))
    calm = share(site.tiles.calm, summary.tiles)
    return {
        "passable": passable,
        "unknown": unknown if parts[1] else "",
        "barred": barred if parts[2] else "",
        "calm": calm,
    }


Row = tuple[Any, ...]
_MOST_SHEETS = 500
"""Rows of the table: 10,000 of them would take more room than the maps."""


def _sheet_rows(site: Site) -> list[Row]:
    rows = []
    for sheet in site.sheets[:_MOST_SHEETS]:
        folder, tiles = str(sheet["folder"]), int(sheet["tiles"])
        name, (west, south, _, _) = PurePosixPath(folder).name, sheet["bounds"]
        rows.append(
            (
                {"text": name, "href": f"{folder}/{REPORT_NAME}"} if site.has_links else name,
                area(tiles * site.tile_area),
                share(sheet["passable"], tiles),
                share(sheet["unknown"], tiles),
                whole(int(sheet["points"])),
                f"{west:,.0f}",
                f"{south:,.0f}",
            )
        )
    return rows


def _class_rows(site: Site) -> list[Row]:
    """Return limits, tiles, area, share, median ride cost and slope of the classes."""
    summary, ranges = site.summary, site.class_ranges or (DASH,) * len(CLASS_NAMES)
    names = (*(f"{code} {name}" for code, name in enumerate(CLASS_NAMES)), "not known")
    counted = _counted(site, [*summary.by_class, summary.unknown], (len(CLASS_NAMES),))
    columns = (names, counted, (*ranges, DASH), summary.median_c_r, summary.median_slope)
    rows: list[Row] = [
        (name, *cells, which, number(c_r, 3), number(slope, 1))
        for name, cells, which, c_r, slope in zip(*columns, strict=True)
    ]
    return [*rows, ("all", *_counted(site, [summary.tiles])[0], "", "", "")]


def _bar_rows(site: Site) -> list[Row]:
    """Return what the vehicle can cross, and what keeps it from the rest."""
    found = site.summary.crossing
    return [
        ({"text": name, "meaning": _WHY[name]}, *cells)
        for name, cells in zip(found, _counted(site, list(found.values()), (0, 1)), strict=True)
        if found[name] or name == BARRED_TEXT[Barred.NO]
    ]


def _reason_rows(site: Site) -> list[Row]:
    """Return why tiles are not known."""
    codes = [code for code in Reason if site.summary.by_reason[code]]
    known = site.summary.tiles - site.summary.unknown
    counted = _counted(site, [*(site.summary.by_reason[code] for code in codes), known], (len(codes),))
    rows: list[Row] = [
        ({"text": REASON_TEXT[code], "meaning": _REASONS[code]}, *cells)
        for code, cells in zip(codes, counted, strict=False)
    ]
    none = {"text": "none", "meaning": "every tile with points has a class"}
    return rows or [(none, share(0, known), area(0.0), whole(0))]


_WHY = {
    BARRED_TEXT[Barred.NO]: "the vehicle can cross it",
    BARRED_TEXT[Barred.UNKNOWN]: "no class: it must not be taken for drivable",
    LITTLE_SEEN: "it has a class, but too little was seen to tell whether there is a way for the vehicle",
    BARRED_TEXT[Barred.OBSTACLE]: "something stands in the way, or the vehicle does not fit between what stands there",
    BARRED_TEXT[Barred.SLOPE]: "steeper than the vehicle may drive",
    BARRED_TEXT[Barred.FAILS]: "at least half of the simulated drives rolled over or got stuck",
    BARRED_TEXT[Barred.STEP]: "a step to or in the tile that the vehicle cannot climb",
    BARRED_TEXT[Barred.SPLIT]: "obstacles part it, or part it from a passable tile beside it: routes pass on pixels",
}
_ALONE = (BARRED_TEXT[Barred.NO], BARRED_TEXT[Barred.UNKNOWN], "not known")
_REASONS = {
    Reason.OK: "rated, but without a ride cost",
    Reason.NO_POINTS: "no point that counts",
    Reason.TOO_FEW_POINTS: "too few points to measure the ground",
    Reason.TOO_MANY_HOLES: "points are there, but large parts of the tile hold none",
    Reason.NO_GROUND: "points are there, but none of them is ground: trees, roofs",
    Reason.OUTLIER_RELIEF: "so many stray points that relief and noise cannot be told apart",
}


def _counted(site: Site, counts: Sequence[int], alone: Collection[int] = ()) -> list[tuple[str, str, str]]:
    """Return share, area and number of all parts of the tiles; see `shares`."""
    told = zip(shares(counts, alone), counts, strict=True)
    return [(part, area(tiles * site.tile_area), whole(tiles)) for part, tiles in told]


def _compared(sites: Sequence[Site]) -> list[tuple[str, str, list[Row]]]:
    """Return the tables of two maps: caption, head, and areas and shares of each with the difference of the shares."""
    summaries = [site.summary for site in sites]
    bars = [name for name in _WHY if any(summary.crossing.get(name) for summary in summaries)]
    codes = [code for code in Reason if any(summary.by_reason[code] for summary in summaries)]
    counts: list[tuple[str, str, Sequence[str], list[list[int]]]] = [
        ("Classes", "class", (*CLASS_NAMES, "not known"), [[*one.by_class, one.unknown] for one in summaries]),
        ("What can be crossed", "ground", bars, [[one.crossing.get(name, 0) for name in bars] for one in summaries]),
        (
            *("Why ground is not known", "reason", [REASON_TEXT[code] for code in codes]),
            [[one.by_reason[code] for code in codes] for one in summaries],
        ),
    ]
    return [(caption, head, _compared_rows(names, found, sites)) for caption, head, names, found in counts]


def _compared_rows(names: Sequence[str], counts: list[list[int]], sites: Sequence[Site]) -> list[Row]:
    first, second = sites
    told = []
    for site, parts in zip(sites, counts, strict=True):  # those shown elsewhere too, and the rest, are rounded alone
        rest = site.summary.tiles - sum(parts)
        alone = {place for place, name in enumerate(names) if name in _ALONE} | ({len(parts)} if rest else set())
        told.append(shares([*parts, rest], alone)[: len(parts)])
    rows = []
    for name, one, two, *texts in zip(names, *counts, *told, strict=True):
        points = 100 * (two / max(second.summary.tiles, 1) - one / max(first.summary.tiles, 1))
        areas = area(one * first.tile_area), area(two * second.tile_area)
        rows.append((name, areas[0], texts[0], areas[1], texts[1], f"{points:+.1f}"))
    return rows


def _way_rows(ways: Sequence[DrawnWay]) -> list[Row]:
    rows: list[Row] = []
    for key, label, decimals, unit in WAY_FIGURES:
        values = [way.figures.get(key) for way in ways]
        if any(value is not None for value in values):
            shown = [number(value, decimals, unit) for value in values]
            if key == "p_arrives":  # 0.998 is not certain
                shown = [share(value, 1.0) if isinstance(value, int | float) else DASH for value in values]
            rows.append((label, *shown))
    return rows


_DIGEST = 16
"""Digits of a checksum that a table shows."""


def _file_rows(record: Mapping[str, Any]) -> list[Row]:
    rows = []
    for item in record.get("inputs") or ():
        kind, colon, digits = str(item.get("checksum") or item.get("sha256") or DASH).rpartition(":")
        rows.append(
            (
                base_name(str(item.get("path", ""))),
                item.get("format", DASH),
                whole(int(item.get("points") or 0)),
                number(float(item["bytes"]) / 1e6, 1, " MB") if item.get("bytes") is not None else DASH,
                f"{kind}{colon}{digits[:_DIGEST]}",
            )
        )
    return rows


def _warnings_of(record: Mapping[str, Any]) -> list[str]:
    """Return warnings that the page does not show elsewhere; files without their folders, which are private."""
    places = [item for name in ("inputs", "skipped_inputs") for item in record.get(name) or ()]
    names = {str(item["path"]) for item in places if isinstance(item, Mapping) and item.get("path")}
    texts = [str(text) for text in record.get("warnings") or ()]
    for path in sorted(names, key=len, reverse=True):
        texts = [text.replace(path, base_name(path)) for text in texts]
    return [text for text in texts if not text.startswith("skipped ")]
