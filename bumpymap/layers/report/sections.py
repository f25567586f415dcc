"""The sections and tables of a page, beside its maps."""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

from bumpymap.core import BARRED_TEXT, CLASS_NAMES, REASON_TEXT, Barred, Reason, count_text
from bumpymap.layers.check.words import check_headline
from bumpymap.layers.colours import class_limits, class_ranges
from bumpymap.layers.products import REPORT_NAME, SHEET_TABLE_NAME
from bumpymap.layers.report.drives import drive_figures
from bumpymap.layers.report.markup import (
    DASH,
    Html,
    area,
    c_r_chart,
    join,
    lines_of,
    number,
    section,
    share,
    shares,
    slope_chart,
    table,
    tag,
    whole,
)
from bumpymap.layers.report.site import DrawnWay, Site
from bumpymap.layers.report.words import base_name, command_of, limits_of, meaning_of, measured_surfaces, settings_of
from bumpymap.layers.summary import LITTLE_SEEN

__all__ = [
    "bar_table",
    "class_table",
    "drive_section",
    "ground_section",
    "lettered",
    "limit_section",
    "reason_table",
    "repeat_section",
    "sheet_section",
    "sheet_table",
    "summary_line",
    "survey_section",
    "vehicle_section",
    "way_section",
]

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


def class_table(sites: Sequence[Site]) -> Html:
    """Return the table of classes: limits, tiles, area, share, median ride cost and slope."""
    if len(sites) > 1:
        return _compared("Classes", ("class", *CLASS_NAMES, "not known"), _class_counts, sites)
    (site,) = sites
    summary, ranges = site.summary, class_ranges(site.record) or (DASH,) * len(CLASS_NAMES)
    counts = _class_counts(site)
    names = (*(f"{code} {name}" for code, name in enumerate(CLASS_NAMES)), "not known")
    columns = zip(_counted(site, counts, (len(CLASS_NAMES),)), summary.median_c_r, summary.median_slope, strict=True)
    rows = [
        (name, *cells, which, number(c_r, 3), number(slope, 1))
        for name, which, (cells, c_r, slope) in zip(names, (*ranges, DASH), columns, strict=True)
    ]
    rows.append(("all", *_counted(site, [summary.tiles])[0], "", "", ""))
    head = ("class", "share", "area", "tiles", "C_r, rad/m", "median C_r, rad/m", "median slope, °")
    told = table("Classes", head, rows, wide=True)
    if not summary.failing:
        return told
    few = (
        f"{whole(summary.failing)} of the tiles in class {len(CLASS_NAMES) - 1} have a lower C_r and are there because "
        "they are too steep or drives fail. The median leaves them out: their C_r is that of the drives that got "
        "through."
    )
    return join(told, tag("p", few, class_="note"))


def bar_table(sites: Sequence[Site]) -> Html:
    """Return the table of what the vehicle can cross, and what keeps it from the rest."""
    if len(sites) > 1:
        names = [name for name in _WHY if any(site.summary.crossing.get(name) for site in sites)]
        return _compared(
            "What can be crossed",
            ("ground", *names),
            lambda site: [site.summary.crossing.get(name, 0) for name in names],
            sites,
        )
    (site,) = sites
    found = site.summary.crossing
    rows = [
        (_explained(name, _WHY[name]), *cells)
        for name, cells in zip(found, _counted(site, list(found.values()), (0, 1)), strict=True)
        if found[name] or name == BARRED_TEXT[Barred.NO]
    ]
    return table("What can be crossed", ("ground", "share", "area", "tiles"), rows)


def reason_table(sites: Sequence[Site]) -> Html:
    """Return the table of why tiles are not known."""
    if len(sites) > 1:
        codes = [code for code in Reason if any(site.summary.by_reason[code] for site in sites)]
        names = [REASON_TEXT[code] for code in codes]
        return _compared(
            "Why ground is not known",
            ("reason", *names),
            lambda site: [site.summary.by_reason[code] for code in codes],
            sites,
        )
    (site,) = sites
    codes = [code for code in Reason if site.summary.by_reason[code]]
    known = site.summary.tiles - site.summary.unknown
    counted = _counted(site, [*(site.summary.by_reason[code] for code in codes), known], (len(codes),))
    rows = [
        (_explained(REASON_TEXT[code], _REASONS[code]), *cells) for code, cells in zip(codes, counted, strict=False)
    ]
    if not rows:
        rows = [(_explained("none", "every tile with points has a class"), share(0, known), area(0.0), whole(0))]
    return table("Why ground is not known", ("reason", "share", "area", "tiles"), rows)


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


def _explained(name: str, meaning: str) -> Html:
    return join(name, tag("span", meaning, class_="meaning"))


def _counted(site: Site, counts: Sequence[int], alone: Collection[int] = ()) -> list[tuple[str, str, str]]:
    """Return share, area and number of all parts of the tiles; see `shares`."""
    told = zip(shares(counts, alone), counts, strict=True)
    return [(part, area(tiles * site.tile_area), whole(tiles)) for part, tiles in told]


def _class_counts(site: Site) -> list[int]:
    return [*site.summary.by_class, site.summary.unknown]


def _shares(names: Sequence[str], counts: list[int], tiles: int) -> list[str]:
    """Return the shares of parts of a map's tiles; those told elsewhere too, and the rest, are rounded alone."""
    alone = {place for place, name in enumerate(names) if name in _ALONE} | {len(counts)}
    rest = tiles - sum(counts)
    return shares([*counts, rest], alone if rest else alone - {len(counts)})[: len(counts)]


def _compared(caption: str, names: tuple[str, ...], counts: Callable[[Site], list[int]], sites: Sequence[Site]) -> Html:
    """Return a table of areas and shares of two maps, and by how many percentage points the share differs."""
    first, second = sites
    rows = []
    found = (counts(first), counts(second))
    told = [_shares(names[1:], one, site.summary.tiles) for one, site in zip(found, sites, strict=True)]
    for name, one, two, *texts in zip(names[1:], *found, *told, strict=True):
        points = 100 * (two / max(second.summary.tiles, 1) - one / max(first.summary.tiles, 1))
        rows.append(
            (
                name,
                area(one * first.tile_area),
                texts[0],
                area(two * second.tile_area),
                texts[1],
                f"{points:+.1f}",
            )
        )
    head = (names[0], "A: area", "A: share", "B: area", "B: share", "B minus A, percentage points")
    return table(caption, head, rows, wide=True)


_FIGURES = (
    # key, label, decimals, unit
    ("length_m", "length", 0, " m"),
    ("detour", "length over the straight line", 2, ""),
    ("seconds", "time at the vehicle's speed", 0, " s"),
    ("c_r_mean", "mean C_r", 3, " rad/m"),
    ("c_r_max", "largest C_r", 3, " rad/m"),
    ("p_arrives", "chance to arrive", 2, ""),
    ("unknown_m", "on ground that is not known", 0, " m"),
    ("obstacle_m", "touching obstacles", 1, " m"),
    ("tight_turns_deg", "turns close to what stops the vehicle", 0, "°"),
    ("climb_m", "climb", 1, " m"),
    ("descent_m", "descent", 1, " m"),
)
_DIGEST = 16
"""Digits of a checksum that a table shows."""


def ground_section(sites: Sequence[Site]) -> Html:
    """Return the tables of classes, bars and reasons, and the histograms."""
    charts = [
        tag(
            "div",
            tag("h3", f"{letter}: {site.name}") if letter else "",
            c_r_chart(site.tiles.c_r_bins, class_limits(site.record) or (), f"ride-{at}"),
            slope_chart(site.tiles.slope_bins, site.record["cost"]["slope_limit_deg"], f"slope-{at}"),
            class_="charts",
        )
        for at, (letter, site) in enumerate(lettered(sites))
    ]
    tables = (class_table(sites), bar_table(sites), reason_table(sites))
    return section("The ground", "ground", *tables, tag("div", *charts, class_="beside"))


def sheet_section(sites: Sequence[Site]) -> Html:
    """Return the sheets of maps that are written in sheets; empty if none is."""
    in_sheets = any(site.record.get("sheets") for site in sites)
    return section("The sheets", "sheets", *_each(sites, sheet_table)) if in_sheets else Html()


def survey_section(sites: Sequence[Site]) -> Html:
    """Return what was surveyed, how densely, where, when, and the files."""
    return section("The survey", "survey", *_each(sites, _survey))


def vehicle_section(sites: Sequence[Site]) -> Html:
    """Return the vehicle and what its numbers mean."""
    parts = _each(sites, lambda site: join(tag("h3", site.vehicle), *(tag("p", line) for line in meaning_of(site))))
    return section("The vehicle, and what its numbers mean", "vehicle", *parts, measured_surfaces())


def way_section(sites: Sequence[Site]) -> Html:
    """Return the figures of ways; empty if there are none."""
    ways = [way for site in sites for way in site.ways]
    return section("The way", "way", _way_table(ways)) if ways else Html()


def drive_section(sites: Sequence[Site]) -> Html:
    """Return what real drives show of the maps; empty if none was checked."""
    checked = [(letter, site.name, site.check) for letter, site in lettered(sites) if site.check is not None]
    parts = [
        tag(
            "div",
            tag("h3", f"{letter}: {name}") if letter else "",
            tag("p", check_headline(check.result)),
            drive_figures(check, letter or "map"),
        )
        for letter, name, check in checked
    ]
    return section("Against real drives", "drives", *parts) if parts else Html()


def limit_section(sites: Sequence[Site]) -> Html:
    """Return what the map does not know."""
    return section("What this map does not know", "limits", *_each(sites, lambda site: lines_of(*limits_of(site))))


def repeat_section(sites: Sequence[Site]) -> Html:
    """Return what is needed to make the layers again."""
    return section("To make these layers again", "again", *_each(sites, _repeat))


def lettered(sites: Sequence[Site]) -> list[tuple[str, Site]]:
    """Return the maps with the letters by which the page names them; a single one needs none."""
    return list(zip(("A", "B") if len(sites) > 1 else ("",), sites, strict=True))


def _each(sites: Sequence[Site], part: Any) -> list[Html]:
    """Return one block for each map, side by side; what two maps share is said once."""
    blocks = [(letter, site, part(site)) for letter, site in lettered(sites)]
    if len(blocks) > 1 and blocks[0][2] == blocks[1][2]:
        return [blocks[0][2]]
    found = [tag("div", tag("h3", f"{letter}: {site.name}") if letter else "", text) for letter, site, text in blocks]
    return [tag("div", *found, class_="beside")] if len(found) > 1 else found


def _facts(rows: Sequence[tuple[str, str]]) -> Html:
    return tag("dl", *(join(tag("dt", name), tag("dd", text)) for name, text in rows))


def _survey(site: Site) -> Html:
    record, summary, spot = site.record, site.summary, site.tiles.spot
    ground = summary.tiles * site.tile_area
    kind = " (those of the ground, class 2)" if record.get("ground_only") else ""
    total = int(record.get("points") or summary.points)
    rows = [
        (
            "points used",
            f"{whole(summary.points)} of {whole(total)}{kind}",
        ),
        (
            "density",
            (
                f"{number(total / ground if ground else None, 1)} points per m² on average, "
                f"{number(summary.points / ground if ground else None, 1)} of them used; "
                f"{number(summary.median_count / site.tile_area, 1)} in the median tile"
            ),
        ),
        ("ground with points", f"{area(ground)} in {whole(summary.tiles)} tiles of {spot.tile_size:g} m"),
        ("extent", f"{spot.cols * spot.tile_size:,.0f} m x {spot.rows * spot.tile_size:,.0f} m"),
        *_crs_facts(record),
        *_date_facts(record),
        *_line_facts(record),
    ]
    inputs = [item for item in record.get("inputs") or [] if isinstance(item, Mapping)]
    files = [
        (
            base_name(str(item.get("path", ""))),
            str(item.get("format", DASH)),
            whole(int(item.get("points") or 0)),
            number(float(item["bytes"]) / 1e6, 1, " MB") if item.get("bytes") is not None else DASH,
            _short(str(item.get("checksum") or item.get("sha256") or DASH)),
        )
        for item in inputs
    ]
    head = ("file", "format", "points", "size", "checksum (first digits)")
    listed = table("Files of the survey", head, files, texts=2, wide=True) if files else Html()
    skipped = record.get("skipped")
    left = [tag("p", f"Left out, because it could not be read: {base_name(str(path))}.") for path in skipped or ()]
    return join(
        _facts(rows), listed, *left, *(tag("p", tag("strong", "Warning: "), text) for text in _warnings(record))
    )


def _warnings(record: Mapping[str, Any]) -> list[str]:
    """Return the warnings of a run that are not told otherwise; files without their folders, which are private."""
    places = [item for name in ("inputs", "skipped_inputs") for item in record.get(name) or ()]
    names = {str(item["path"]) for item in places if isinstance(item, Mapping) and item.get("path")}
    texts = [str(text) for text in record.get("warnings") or ()]
    for path in sorted(names, key=len, reverse=True):
        texts = [text.replace(path, base_name(path)) for text in texts]
    return [text for text in texts if not text.startswith("skipped ")]


def _crs_facts(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    crs, units = record.get("crs"), record.get("metres_per_unit") or {}
    if crs is None:
        return [("coordinates", "local, no CRS")]
    horizontal, _, vertical = str(crs["name"]).partition(" + ")
    code = f" ({crs['code']})" if crs.get("code") else ""
    rows = [("CRS", f"{horizontal}{code}"), ("heights", vertical or "not stated by the survey")]
    if units and (units.get("horizontal"), units.get("vertical")) != (1.0, 1.0):
        rows.append(("units", f"{units['horizontal']:g} m horizontally, {units['vertical']:g} m vertically"))
    return rows


def _date_facts(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    survey = record.get("survey")
    dates = survey.get("dates") if isinstance(survey, Mapping) else None
    if not dates:
        return [("date", "not stated by the files")]
    first, last = str(dates[0]), str(dates[-1])
    return [("date of the files", first if first == last else f"{first} to {last}")]


def _line_facts(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    lines = record.get("flight_lines")
    if not isinstance(lines, Mapping) or not lines.get("lines"):
        return []
    pairs = [pair for pair in lines.get("pairs") or [] if isinstance(pair, Mapping)]
    text = whole(int(lines["lines"]))
    if pairs:
        largest = max(abs(float(pair.get("largest") or 0.0)) for pair in pairs)
        overlap = count_text(len(pairs), "pair overlaps", "pairs overlap")
        text += f"; {overlap}, largest height step between them {100 * largest:.1f} cm"
    if lines.get("method") not in {None, "none"}:
        text += f"; heights of the lines were adjusted ({lines['method']})"
    return [("flight lines", text)]


def _way_table(ways: Sequence[DrawnWay]) -> Html:
    rows = []
    for key, label, decimals, unit in _FIGURES:
        values = [way.figures.get(key) for way in ways]
        if any(value is not None for value in values):
            shown = [number(value, decimals, unit) for value in values]
            if key == "p_arrives":  # 0.998 is not certain
                shown = [share(value, 1.0) if isinstance(value, int | float) else DASH for value in values]
            rows.append((label, *shown))
    return table("Figures of the way", ("figure", *(way.name for way in ways)), rows, wide=len(ways) > 2)


def _repeat(site: Site) -> Html:
    record = site.record
    command = command_of(record)
    known = record.get("calibration")
    identity = known.get("id") if isinstance(known, Mapping) else known
    rows = [("calibration", f"{identity} ({site.vehicle})"), ("texture model", str(record.get("model") or DASH))]
    rows += settings_of(record)
    versions = record.get("versions") or {}
    listed = ", ".join(f"{name} {version}" for name, version in sorted(versions.items()))
    parts = [
        tag("p", "With the files of the survey, the versions and the settings below:") if command else Html(),
        tag("pre", tag("code", command), tabindex="0") if command else Html(),
        _facts([*rows, ("versions", listed)]),
        tag("p", "run.json beside this page holds all of it, with the checksums of the layers.", class_="note"),
    ]
    return join(*parts)


def _short(checksum: str) -> str:
    kind, _, digits = checksum.rpartition(":")
    return f"{kind}:{digits[:_DIGEST]}" if kind else digits[:_DIGEST]


def summary_line(site: Site) -> str:
    """Return vehicle, area, points and CRS in one line, for the head of the page."""
    ground = site.summary.tiles * site.tile_area
    return " · ".join(
        (
            f"vehicle {site.vehicle}",
            f"{area(ground)} with points",
            f"{whole(int(site.record.get('points') or site.summary.points))} points",
            f"{share(site.summary.passable, site.summary.tiles)} passable",
            site.crs_name,
        )
    )
