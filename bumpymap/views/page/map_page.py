"""The page of a map, and of drives over a map: as a view of a run that is ending, or again."""

import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj.exceptions import ProjError

from bumpymap.core import (
    BARRED_TEXT,
    CLASS_NAMES,
    CROSSING_UNKNOWN,
    NO_CLASS,
    OBJECT_NAMES,
    OBSTACLE,
    REASON_TEXT,
    BadInputError,
    Barred,
    OutputError,
    PageSettings,
    Reason,
    SeenSizes,
    UsageError,
    chance_text,
    utf8_path,
)
from bumpymap.layers import (
    BARRED_COLOURS,
    CLASS_COLOURS,
    CLOSED_COLOUR,
    ISLAND_SHARE,
    MANIFEST_NAME,
    OBJECT_COLOURS,
    OFF_COLOURS,
    REPORT_NAME,
    ROUTE_COLOUR,
    STEP_LINE,
    UNKNOWN_COLOUR,
    MapFile,
    RideScale,
    class_ranges,
    read_manifest,
    require_new_file,
    require_written,
)
from bumpymap.views.fields import field_names
from bumpymap.views.light import DETAIL
from bumpymap.views.page.charts import along_chart, drive_chart, profile_chart
from bumpymap.views.page.page import write_page
from bumpymap.views.page.site import RAMP, WAY_FIGURES, DrawnWay, Site, page_header, read_ways
from bumpymap.views.page.tiles import UNKNOWN_FROM
from bumpymap.views.words import (
    DASH,
    PERCENT,
    agreements_of,
    area,
    base_name,
    check_headline,
    degrees,
    metres,
    number,
    percent,
    read_surfaces,
    seen_sizes,
    share,
    shares,
    warnings_of,
    whole,
    zones_line,
)

if TYPE_CHECKING:
    from bumpymap.core import CheckResult, MapAgreement
    from bumpymap.layers import MapReader

_SUFFIXES = {".html", ".htm"}
_READ = (MapFile.CLASS, MapFile.HEIGHTMAP, MapFile.OBSTACLE, MapFile.TILES)


def write_report(
    layers: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    route: str | os.PathLike[str] | None = None,
    page: PageSettings | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the page of a map again.

    ``layers``: a folder that `bumpymap map` wrote; ``out``: the file; default is report.html in the folder of the
    layers, which is replaced, since it can be made again; ``route``: a folder that `bumpymap route` wrote: its ways are
    drawn; ``page``: header of the page; what it does not give is as the map was made with; ``overwrite``: replace
    ``out`` if it exists. Returns the file. Raises UsageError: ``out`` is not named like a page; BadInputError: the
    folder holds no complete layers, or they cannot be read, or ``route`` holds no way; OutputError: the page cannot be
    written, or exists.
    """
    folder = Path(layers)
    path = folder / REPORT_NAME if out is None else Path(out)
    record = read_manifest(folder)
    header = page_header(page or PageSettings())
    _check(path, replace=overwrite or out is None)
    try:
        with utf8_path(folder) as readable:
            require_written(folder, record, _READ)
            ways = () if route is None else read_ways(Path(route), record)
            record = {**record, "page": {**(record.get("page") or {}), **header}}
            write_map_page(Site.read(readable, record, ways), path)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError, ProjError) as error:
        raise BadInputError(
            f"{folder / MANIFEST_NAME} is not that of a map of this version: {error!r}. Map the survey again"
        ) from error
    return path


def _check(path: Path, *, replace: bool) -> None:
    """Refuse, before anything is read, what cannot be written. A link is replaced as a link, never followed."""
    if path.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"{path} is not named like a page. Give a file that ends in .html as `out`")
    if path.is_dir() and not path.is_symlink():
        raise OutputError(f"cannot write {path}: it is a folder. Name a file with `out`, such as {path / REPORT_NAME}")
    require_new_file(path, overwrite=replace)


def write_map_page(site: Site, path: Path) -> None:
    """Write the page of a map. The same layers give the same page: it holds no time and no folder.

    Raises OutputError: the page cannot be written.
    """
    real = read_surfaces()
    write_page(
        path,
        "map.html",
        site=site,
        bar_rows=_bar_rows(site),
        class_bar=_class_bar(site),
        class_rows=_class_rows(site),
        crossed=_crossed(site),
        file_rows=_file_rows(site.record),
        real=real,
        reason_rows=_reason_rows(site),
        seen=seen_sizes(site.record).sentence,
        surface_rows=[(name, f"{c_r:.3f}", degrees(c_r)) for name, c_r in real["c_r"].items()],
        warnings=_warnings_of(site.record),
        zones=zones_line(site.summary.zones),
        way_heads=[f"{way.letter} {way.name}" for way in site.ways],
        ways=_ways(site),
        way_rows=_way_rows(site.ways),
        **_of_map(site),
    )


def _of_map(site: Site | None) -> dict[str, Any]:
    """Return what the figure of a map needs, with the data of the script."""
    return {
        "obstacle_colour": OBJECT_COLOURS[OBSTACLE],
        "ramp_colours": RAMP,
        "way_colour": ROUTE_COLOUR,
        "ranges": class_ranges(site.record) if site else (),
        "data": {"maps": [site.map_record()] if site else [], "codes": _CODES},
    }


_CODES = {
    "unknownFrom": UNKNOWN_FROM,
    "littleSeen": int(Barred.LITTLE_SEEN),
    "classes": list(CLASS_NAMES),
    "reasons": [REASON_TEXT[code] for code in Reason],
    "barred": [BARRED_TEXT[code] for code in Barred],
    "objects": list(OBJECT_NAMES),
    "classColours": [CLASS_COLOURS[code] for code in range(len(CLASS_NAMES))],
    "barredColours": [BARRED_COLOURS[code] for code in Barred],
    "obstacleColour": OBJECT_COLOURS[OBSTACLE],
    "solids": [OBSTACLE, STEP_LINE],
    "closedColour": CLOSED_COLOUR,
    "islandPart": ISLAND_SHARE,
    "strength": DETAIL,
    "wayColour": ROUTE_COLOUR,
    "offColours": [OFF_COLOURS[code] for code in range(len(OFF_COLOURS))],
    "unknownColour": UNKNOWN_COLOUR,
}
"""Names and colours of the codes in the grids."""


def write_check_page(result: "CheckResult", ground: "MapReader | None", path: Path) -> None:
    """Write check.html: the drives over the map they were checked against, charts, tables, how to read them.

    Without a map, or where its layers cannot be drawn, the page has no map. ``ground``: the map; None without one.
    Raises OutputError: the page cannot be written.
    """
    site = None if ground is None else _driven_site(result, ground)
    names, more = ", ".join(drive.name for drive in result.drives[:3]), len(result.drives) - 3
    names += f" and {more} more" if more > 0 else ""
    title = f"{result.ground.name} checked against {names}" if result.ground else f"Drives measured: {names}"
    write_page(
        path,
        "check.html",
        title=title,
        headline=check_headline(result),
        result=result,
        warnings=[*(f"{drive} is left out: {why}" for drive, why in result.skipped.items()), *warnings_of(result)],
        agreement=[_agreement(name, found) for name, found in agreements_of(result) if found.stretches],
        worst=_worst(result),
        charts=[chart for chart in (drive_chart(result), along_chart(result)) if chart is not None],
        site=site,
        **_of_map(site),
    )


def _driven_site(result: "CheckResult", ground: "MapReader") -> Site | None:
    """Return the map; None if no stretch lies on it, or it cannot be drawn."""
    try:
        with utf8_path(ground.folder) as readable:
            site = Site.read(readable, ground.manifest, stretches=drawn_stretches(result))
    except BadInputError:
        return None
    spot, stretches = site.tiles.spot, result.stretches
    east, south = stretches.easting - spot.west, spot.north - stretches.northing
    inside = (east >= 0) & (east < spot.cols * spot.tile_size) & (south >= 0) & (south < spot.rows * spot.tile_size)
    return site if inside.any() else None


def drawn_stretches(result: "CheckResult") -> list[dict[str, Any]]:
    """Return each stretch with a position as the script of the page needs it."""
    from bumpymap.layers import MapOffset

    stretches, offset, drawn = result.stretches, MapOffset.of(result.stretches), []
    for at in np.flatnonzero(np.isfinite(stretches.easting) & np.isfinite(stretches.northing)).tolist():
        text = f"{result.drives[stretches.drive[at]].name} measured {stretches.measured[at]:.3f} rad/m"
        ratio = float(offset.ratio[at])
        if np.isfinite(ratio):
            level = f"{percent(abs(ratio - 1.0))} {'high' if ratio > 1.0 else 'low'}"
            text += f", the map says {stretches.c_r[at]:.3f} along the stretch ({level})"
        place = {"east": round(float(stretches.easting[at]), 2), "north": round(float(stretches.northing[at]), 2)}
        drawn.append(place | {"kind": int(offset.kind[at]), "off": bool(offset.is_off[at]), "text": text})
    return drawn


def _agreement(name: str, found: "MapAgreement") -> tuple[str, ...]:
    return (
        name,
        f"{found.stretches:,}",
        metres(found.way_m),
        number(found.median_ratio, 2),
        percent(found.median_error),
        number(found.spearman, 2),
        percent(found.inside),
        percent(found.same_class),
    )


def _worst(result: "CheckResult") -> list[tuple[str, ...]]:
    """Return the stretches that are farthest off, of those whose difference errors do not explain; at most 10."""
    from bumpymap.layers import MapOffset

    stretches, offset = result.stretches, MapOffset.of(result.stretches)
    order = np.argsort(-np.nan_to_num(offset.beyond, posinf=np.inf), kind="stable")
    classes = dict(enumerate(CLASS_NAMES)) | {NO_CLASS: "off the map"}
    return [
        (
            result.drives[stretches.drive[at]].name,
            f"{stretches.start_s[at]:.1f} s",
            f"{stretches.easting[at]:.1f}, {stretches.northing[at]:.1f}",
            f"{stretches.measured[at]:.3f} ± {stretches.measured_sd[at]:.3f}",
            f"{stretches.c_r[at]:.3f} ({classes[int(stretches.class_id[at])]})",
            f"{number(float(stretches.c_r_low[at]), 3)} to {number(float(stretches.c_r_high[at]), 3)}",
            f"{offset.ratio[at]:.2f}",
        )
        for at in order[:10].tolist()
        if offset.is_off[at]
    ]


def _crossed(site: Site) -> dict[str, str]:
    """Return the shares of the headline, empty where there is no such ground."""
    parts = _parts_of(site)
    passable, unknown, barred = shares(parts, (0, 1))
    calm = share(int(site.tiles.free[:2].sum()), site.summary.tiles)
    return {
        "passable": passable,
        "unknown": unknown if parts[1] else "",
        "barred": barred if parts[2] else "",
        "calm": calm,
    }


def _parts_of(site: Site) -> tuple[int, int, int]:
    """Return the tiles that can be crossed, those of which that is not known, and the others."""
    summary = site.summary
    unknown = sum(summary.by_bar[code] for code in CROSSING_UNKNOWN)
    return summary.passable, unknown, summary.tiles - summary.passable - unknown


Row = tuple[Any, ...]


def _class_rows(site: Site) -> list[Row]:
    """Return limits, tiles, area, share, median ride cost and slope of the classes."""
    summary, ranges = site.summary, class_ranges(site.record) or (DASH,) * len(CLASS_NAMES)
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
    codes = [code for code in Reason if site.summary.by_reason[code]]
    known = site.summary.tiles - site.summary.unknown
    counted = _counted(site, [*(site.summary.by_reason[code] for code in codes), known], (len(codes),))
    rows: list[Row] = [
        ({"text": REASON_TEXT[code], "meaning": _REASONS[code]}, *cells)
        for code, cells in zip(codes, counted, strict=False)
    ]
    none = {"text": "none", "meaning": "every tile with points has a class"}
    return rows or [(none, share(0, known), area(0.0, site.ground), whole(0))]


_WHY = {
    BARRED_TEXT[Barred.NO]: "the vehicle can cross it",
    BARRED_TEXT[Barred.UNKNOWN]: "no class: it must not be taken for drivable",
    BARRED_TEXT[Barred.OBSTACLE]: "an obstacle is in the way, or the vehicle does not fit between obstacles",
    BARRED_TEXT[Barred.SLOPE]: "steeper than the vehicle may drive",
    BARRED_TEXT[Barred.FAILS]: "at least half of the simulated drives rolled over or got stuck",
    BARRED_TEXT[Barred.STEP]: "a step that the vehicle cannot climb closes it in part: routes pass on pixels",
    BARRED_TEXT[Barred.SPLIT]: "obstacles part it, or part it from a passable tile beside it: routes pass on pixels",
    BARRED_TEXT[Barred.LITTLE_SEEN]: "it has a class, but obstacles may be unseen: there may be a way or none",
}
_REASONS = {
    Reason.OK: "rated, but without a ride cost",
    Reason.NO_POINTS: "no point that counts",
    Reason.TOO_FEW_POINTS: "too few points to measure the ground",
    Reason.TOO_MANY_HOLES: "points are there, but large parts of the tile hold none",
    Reason.NO_GROUND: "points are there, but none of them is ground: trees, roofs",
    Reason.OUTLIER_RELIEF: "too many stray points to distinguish relief from noise",
}


def _counted(site: Site, counts: Sequence[int], alone: Collection[int] = ()) -> list[tuple[str, str, str]]:
    """Return share, area and number of all parts of the tiles; see `shares`."""
    parts = zip(shares(counts, alone), counts, strict=True)
    return [(part, area(tiles * site.tile_area, site.ground), whole(tiles)) for part, tiles in parts]


def _way_rows(ways: Sequence[DrawnWay]) -> list[Row]:
    """Return the figures of ways, a row each, its unit in its name."""
    rows: list[Row] = []
    for key, decimals in WAY_FIGURES:
        values = [way.figures.get(key) for way in ways]
        if any(value is not None for value in values):
            shown, name = [number(value, decimals) for value in values], field_names("route.geojson")[key]
            if key == "p_arrives":
                shown = [chance_text(value, 0, PERCENT) if isinstance(value, int | float) else DASH for value in values]
            rows.append((name, *shown))
            if key == "p_arrives":
                rows.append(("the chance holds", *(SeenSizes.of(way.figures).condition for way in ways)))
    return rows


def _ways(site: Site) -> list[tuple[DrawnWay, str, dict[str, Any] | None]]:
    """Return ways, each with a line of what decides between them and its profile, if there is one."""
    lines = []
    for way in site.ways:
        texts = [number(way.figures.get("length_m"), 0, " m"), number(way.figures.get("cost_m"), 0, " m of cost")]
        seconds, arrives = (way.figures.get(key) for key in ("seconds", "p_arrives"))
        texts += [number(seconds / 60, 1, " minutes")] if isinstance(seconds, int | float) else []
        if isinstance(arrives, int | float):
            texts += [f"{chance_text(arrives, 0, PERCENT)} to arrive {SeenSizes.of(way.figures).condition}"]
        touched = way.figures.get("obstacle_m") or 0.0
        texts += [f"{number(touched, 1, ' m')} touching obstacles" if touched else "touches no obstacle"]
        chart = profile_chart(way.profile, RideScale.of(site.record)) if way.profile else None
        lines.append((way, ", ".join(text for text in texts if not text.startswith(DASH)), chart))
    return lines


def _class_bar(site: Site) -> list[tuple[str, tuple[int, ...], str, float]]:
    """Return name, colour, share in words and share in per cent of what can be crossed by class, and of the rest."""
    passable, unknown, barred = _parts_of(site)
    classes, total = site.tiles.free.tolist(), site.summary.tiles
    texts = shares([*classes, total - passable], (len(classes),))[:-1]  # they make what the headline says is passable
    texts += shares((passable, unknown, barred), (0, 1))[:0:-1]
    colours = [*(CLASS_COLOURS[code] for code in range(len(classes))), CLOSED_COLOUR, UNKNOWN_COLOUR]
    parts = [100.0 * count / max(total, 1) for count in (*classes, barred, unknown)]
    return list(zip((*CLASS_NAMES, "cannot be crossed", "not known"), colours, texts, parts, strict=True))


def _file_rows(record: Mapping[str, Any]) -> list[Row]:
    rows = []
    for item in record["inputs"]:
        kind, colon, digits = str(item.get("checksum") or item.get("sha256") or DASH).rpartition(":")
        rows.append(
            (
                base_name(str(item.get("path", ""))),
                item.get("format", DASH),
                whole(int(item.get("points") or 0)),
                number(float(item["bytes"]) / 1e6, 1, " MB") if item.get("bytes") is not None else DASH,
                f"{kind}{colon}{digits[:16]}",  # enough to tell files apart
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
