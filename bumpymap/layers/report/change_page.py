"""Write the page of what has changed between two surveys: its map, what it says, its tables."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bumpymap.core import (
    CHANGE_KINDS,
    CLASS_NAMES,
    BadInputError,
    Each,
    Nullable,
    Number,
    atomic,
    count_text,
    read_record,
    shape_fault,
)
from bumpymap.layers.colours import CHANGE_COLOURS
from bumpymap.layers.manifest import COUNT, PLACE_SHAPE
from bumpymap.layers.report.change_site import NOT_COMPARED, ChangedPlace, ChangeSite
from bumpymap.layers.report.map_figure import controls_of, scale_of, stage_of
from bumpymap.layers.report.markup import (
    DASH,
    Html,
    area,
    document,
    join,
    lines_of,
    number,
    section,
    share,
    shares,
    swatch,
    table,
    tag,
    whole,
)
from bumpymap.layers.report.site import plain_name
from bumpymap.layers.report.tiles import NOT_KNOWN, ByteGrid

__all__ = [
    "DIFFERENCE_RAMP",
    "change_figure",
    "change_headline",
    "class_section",
    "is_comparison",
    "kind_section",
    "limits_section",
    "place_section",
    "read_comparison",
    "settings_section",
    "surveys_section",
    "titles",
    "write_change_report",
]

DIFFERENCE_RAMP = (
    *("#053061", "#2166ac", "#4393c3", "#92c5de", "#f7f7f7"),
    *("#f4a582", "#d6604d", "#b2182b", "#67001f"),
)
"""Colours from the least over none, white, to the most of a difference."""
_GREY = (178, 178, 178)
_NAMES = {"d_height": "Difference of height", "d_c_r": "Difference of ride cost C_r"}


def change_figure(site: ChangeSite, title: str) -> Html:
    """Return the figure of the map; the script fills it."""
    grids = [grid for grid in site.grids if (grid.codes != NOT_KNOWN).any()]
    names = [("changed", "What has changed"), *((grid.key, _NAMES[grid.key]) for grid in grids)]
    radios = [
        tag("label", tag("input", type="radio", name="layer-0", value=key, checked=key == "changed"), f" {name}")
        for key, name in names
    ]
    box = tag("input", type="checkbox", value="places", checked=True)
    boxes = [tag("label", box, " Numbers of the places")] if site.places else []
    legends = [_legend("changed"), *(_legend(grid.key, grid) for grid in grids)]
    return tag(
        "figure",
        controls_of(radios, boxes),
        stage_of(title, site.still, "what has changed", 0),
        tag("div", *legends, class_="legends"),
        tag("p", _notes(site, grids), class_="note"),
        class_="map",
        data_map="0",
    )


def _legend(key: str, grid: ByteGrid | None = None) -> Html:
    if grid is None:
        items = [tag("li", swatch(CHANGE_COLOURS[code]), f" {name}") for code, name in enumerate(CHANGE_KINDS)]
        last = " not compared: may have changed or not"
    else:
        items = [scale_of(grid, DIFFERENCE_RAMP, ("blue", "red"))]
        last = " not compared, or not known in one survey"
    items.append(tag("li", swatch(_GREY, hatched=True), last))
    return tag("ul", *items, class_="legend", data_of=key, hidden=grid is not None)


def _notes(site: ChangeSite, grids: list[ByteGrid]) -> str:
    if site.step > 1:
        size = (
            f"One pixel of the map is {site.metres:g} m, {site.step} x {site.step} tiles of {site.tile_size:g} m. It "
            "shows a change if one of its tiles has changed; else it counts as not compared if one of them was not. "
            "Its differences are those farthest from 0."
        )
    else:
        size = f"One square of the map is a tile of {site.tile_size:g} m."
    text = f"{size} Differences are those of all tiles, changed or not: most are noise. "
    text += "Colours go with the square root of a difference, so that small ones are seen."
    left = site.record["counts"]["regions"] - len(site.places)
    if left:
        text += f" The {len(site.places)} largest places are framed, {left:,} are not."
    rounding = "; ".join(grid.rounding for grid in grids)
    return f"{text} Values are rounded for this page ({rounding}); change.tif holds them in full." if grids else size


_SIDES = ("before", "after")
_ROUGHER, _SMOOTHER = "rougher", "smoother"
_USUAL = {"fdr": 0.05, "min_tiles": 2, "offset": None}
"""Settings of a comparison that `--out` alone gives."""
_MEANING = {
    "not changed": "no change was found; one smaller than the noise stays unseen",
    "ground changed, ride as before": "the ground has another height or shape; no change of the ride was found",
    "rougher": "the ground has changed and is rougher to ride on",
    "smoother": "the ground has changed and is smoother to ride on",
    "ground changed, ride unknown": "the ground has changed; the ride over it is not known in one survey or in both",
}


def titles(site: ChangeSite) -> tuple[str, str]:
    """Return what the two surveys are called: by name, with dates if the names are the same."""
    names = [plain_name(_run(site, side)) for side in _SIDES]
    if names[0] == names[1]:
        days = [_dates(_run(site, side)) for side in _SIDES]
        told = days if None not in days and days[0] != days[1] else _SIDES
        names = [f"{name} ({what})" for name, what in zip(names, told, strict=True)]
    return names[0], names[1]


def change_headline(site: ChangeSite) -> str:
    """Return the result: how many places have changed, how much of the ground, and what became of the ride."""
    counts = site.record["counts"]
    compared, regions, changed = (int(counts[name]) for name in ("compared", "regions", "changed"))
    if not compared:
        return "Nothing could be compared: whether the ground has changed is not known."
    if not changed:
        return f"No change was found on the {area(site.area_of(compared))} that were compared."
    text = (
        f"{count_text(regions, 'place has', 'places have')} changed, {area(site.area_of(changed))} of "
        f"{area(site.area_of(compared))} compared"
    )
    tiles = counts["by_change"]
    rides = [(kind, area(site.area_of(int(tiles[kind])))) for kind in (_ROUGHER, _SMOOTHER) if tiles[kind]]
    if not rides:
        return f"{text}; no change of the ride was found there."
    return f"{text}; {' and '.join(f'{size} became {kind}' for kind, size in rides)} to ride on."


def kind_section(site: ChangeSite) -> Html:
    """Return the table of what became of the tiles."""
    counts = site.record["counts"]
    compared, both = int(counts["compared"]), int(counts["in_both"])
    rows: list[tuple[str, ...]] = [
        (
            join(name, tag("span", _MEANING[name], class_="meaning")),
            told,
            *_amount(site, int(counts["by_change"][name]), compared)[1:],
        )
        for name, told in zip(
            CHANGE_KINDS, shares([int(counts["by_change"][kind]) for kind in CHANGE_KINDS]), strict=True
        )
    ]
    rows += [
        ("compared", *_amount(site, compared, compared)),
        (
            join(
                "in both surveys, not compared",
                tag("span", "too few places where both have points: may have changed or not", class_="meaning"),
            ),
            *_amount(site, both - compared),
        ),
    ]
    lost, won = int(counts["passable_lost"]), int(counts["passable_won"])
    notes = [
        (
            f"Of the changed tiles, {count_text(lost, 'is', 'are')} no longer passable, and "
            f"{count_text(won, 'has', 'have')} become passable."
        ),
        (
            f"{count_text(int(counts['dropped_as_too_small']), 'tile')} differed too, in groups of fewer than "
            f"{site.record['settings']['min_tiles']}; they were left out and count as not changed."
        ),
    ]
    head = ("what became of them", "share of compared", "area", "tiles")
    parts = [table("Tiles by what became of them", head, rows), *(tag("p", note) for note in notes)]
    return section("Counts", "counts", *parts)


def class_section(site: ChangeSite) -> Html:
    """Return the table of classes before and after."""
    names = (*(f"{code} {name}" for code, name in enumerate(CLASS_NAMES)), "not known")
    rows = [
        (name, *(whole(int(tiles)) for tiles in row))
        for name, row in zip(names, site.record["classes"]["tiles_before_after"], strict=True)
    ]
    note = (
        "All tiles that both surveys have, changed or not. A tile near the limit between two classes falls to one or "
        "the other by the noise of its survey: read tiles off the diagonal as changes only where the map says so."
    )
    head = ("before, down; after, across", *names)
    return section(
        "Classes before and after", "classes", table("Tiles by class", head, rows, wide=True), tag("p", note)
    )


def place_section(site: ChangeSite) -> Html:
    """Return the table of the places, the largest first."""
    total = int(site.record["counts"]["regions"])
    if not site.places:
        return section("Places", "places", tag("p", "No place was found that has changed."))
    x, y, decimals = ("longitude, °", "latitude, °", 6) if site.degrees else ("x", "y", 1)
    head = (
        *("place, and its ride", "area", "tiles", "height, m", "lowest to highest, m", "volume, m³"),
        *("C_r before, rad/m", "C_r after, rad/m", "difference, rad/m", x, y),
    )
    rows = [_place_row(site, place, decimals) for place in site.places]
    left = total - len(rows)
    more = f" {count_text(left, 'smaller one is', 'smaller ones are')} in change.geojson." if left else ""
    note = (
        "The largest first, with what became of the ride in how many of its tiles. Numbers are those on the map and "
        "the ids in change.geojson. Heights and C_r are means over the place,"
        f" after minus before; a positive volume was heaped up.{more}"
    )
    return section("Places", "places", table("Places that have changed", head, rows, wide=True), tag("p", note))


def surveys_section(site: ChangeSite) -> Html:
    """Return the two surveys side by side, and what is to be known of how they fit each other."""
    fit = site.record["fit"]
    runs = [_run(site, side) for side in _SIDES]
    inputs = [[item for item in run.get("inputs") or () if isinstance(item, Mapping)] for run in runs]
    rows = [
        ("name", *map(plain_name, runs)),
        ("dates in the files", *(_dates(run) or "not stated" for run in runs)),
        ("files", *(whole(len(items)) for items in inputs)),
        ("points in the files", *(whole(sum(int(item.get("points") or 0) for item in items)) for items in inputs)),
        (
            "points per m² where both have tiles, median",
            *(number(value, 1) for value in fit["median_density_m2"]),
        ),
        ("made by version", *(str(version or "not stated") for version in fit["versions"])),
    ]
    remarks = [f"{text[:1].upper()}{text[1:]}." for text in map(str, site.record.get("remarks") or ())]
    head = tag("h3", "What to know before the changes are believed")
    parts = join(head, lines_of(*remarks)) if remarks else Html()
    return section(
        "The two surveys", "surveys", table("Before and after", ("of the survey", "before", "after"), rows), parts
    )


def settings_section(site: ChangeSite) -> Html:
    """Return the settings, and what the share of false discoveries means."""
    settings, fit, counts = site.record["settings"], site.record["fit"], site.record["counts"]
    fdr, least = float(settings["fdr"]), int(settings["min_tiles"])
    changed = int(counts["changed"])
    widened = ", ".join(f"{float(factor):.2f} times ({name})" for name, factor in fit["widened"].items())
    rows = [
        ("false discoveries", f"at most {100 * fdr:g} % of what is found, on average"),
        ("smallest change", f"{least} tiles that share sides, {area(site.area_of(least))}"),
        ("height taken off the later survey", number(fit["offset_taken_off_m"], 3, " m")),
        ("heights compared in squares of", f"{float(fit['cell_m']):g} m"),
        ("noise taken as", f"{widened} what the points show"),
        ("vehicle, calibration", f"{site.record['vehicle']}, {site.record['calibration']}"),
    ]
    expected = f" Of the {whole(changed)} changed tiles here, that is some {fdr * changed:.0f}." if changed else ""
    words = [
        (
            "Two surveys of the same ground never give the same heights. A tile counts as changed if its difference is "
            "larger than the noise of its own points explains. Among thousands of tiles, noise alone makes a few look "
            f"changed; the limit is set so that, on average, at most {100 * fdr:g} in 100 tiles found are there by "
            f"chance.{expected} These tend to lie alone, so leaving out small groups removes most of them."
        ),
        (
            "The reverse does not hold: ground that is not found changed may have changed by less than its noise. On "
            "asphalt that is centimetres, in scrub and among blocks decimetres."
        ),
        (
            "A change of the ride counts only on ground that has changed: a ride cost can jump although nothing has "
            "moved, when a stone lies in or out of a wheel's way."
        ),
    ]
    command = ["bumpymap diff BEFORE AFTER --out DIR"]
    command += [
        f"--{name.replace('_', '-')} {shlex.quote(f'{settings[name]:g}')}"
        for name, usual in _USUAL.items()
        if settings[name] != usual
    ]
    again = tag("pre", tag("code", " ".join(command)), tabindex="0")
    facts = tag("dl", *(join(tag("dt", name), tag("dd", text)) for name, text in rows))
    note = "change.json beside this page holds all of it, with the checksums of both surveys' layers."
    told = [tag("p", text) for text in words]
    return section(
        "How it was decided", "settings", *told, facts, tag("p", "To repeat it:"), again, tag("p", note, class_="note")
    )


def limits_section(site: ChangeSite) -> Html:
    """Return what the comparison does not know."""
    limits = [
        (
            "Ground that could not be compared, or that lies in one survey only, may have changed or not. It is grey "
            "and hatched on the map, and in no count of what has not changed."
        ),
        (
            "Errors that neighbouring points of a survey share look like changes: a photogrammetric model that is "
            "bent, a flight line that hangs, a strip of wrong matches."
        ),
        "Plants that have grown or were cut have changed too, unless only ground points were mapped.",
        (
            "What stands on the ground and is no part of the heightmap is not compared: cars, and trees that were left "
            "out as no ground."
        ),
        "It knows shape, not firmness: ground that has become wet, loose or frozen has not changed here.",
        f"A change is told by tiles of {site.tile_size:g} m; its true outline lies somewhere in them.",
        f"Ride costs are those of one vehicle, {site.record['vehicle']}, at one speed.",
    ]
    if not site.degrees:
        limits.append("The surveys have no CRS: places have coordinates of their own, but no place on Earth.")
    return section("What this comparison does not know", "limits", lines_of(*limits))


def _run(site: ChangeSite, side: str) -> Mapping[str, Any]:
    """Return the first run of a survey: sheets of one map have the same survey."""
    runs: Sequence[Mapping[str, Any]] = site.record["sources"][side]["runs"]
    return runs[0]


def _dates(run: Mapping[str, Any]) -> str | None:
    survey = run.get("survey")
    dates = survey.get("dates") if isinstance(survey, Mapping) else None
    if not dates:
        return None
    first, last = str(dates[0]), str(dates[-1])
    return first if first == last else f"{first} to {last}"


def _amount(site: ChangeSite, tiles: int, total: int = 0) -> tuple[str, str, str]:
    return share(tiles, total), area(site.area_of(tiles)), whole(tiles)


def _place_row(site: ChangeSite, place: ChangedPlace, decimals: int) -> tuple[str, ...]:
    """Return the cells of a place: its number with the ride of its tiles, sizes, differences, a point in it."""
    about = place.about
    tiles = int(about["tiles"])
    kinds = [
        (name.removeprefix("ground changed, ride "), int(about[name.replace(",", "").replace(" ", "_")]))
        for name in CHANGE_KINDS[1:]
    ]
    found = [(name, count) for name, count in kinds if count]
    ride = found[0][0] if len(found) == 1 else ", ".join(f"{name} in {whole(count)}" for name, count in found)
    low, high = (_signed(about[name], 2) for name in ("d_height_lowest", "d_height_highest"))
    return (
        join(str(place.number), tag("span", ride, class_="meaning")),
        area(site.area_of(tiles)),
        whole(tiles),
        _signed(about["d_height"], 2),
        f"{low} to {high}",
        _signed(about["volume_m3"], 1),
        number(about["c_r_before"], 3),
        number(about["c_r_after"], 3),
        _signed(about["d_c_r"], 3),
        *(f"{value:.{decimals}f}" for value in place.where),
    )


def _signed(value: Any, decimals: int) -> str:
    """Return a difference with its sign."""
    text = number(value, decimals)
    if text == DASH or not text.strip("-0."):
        return text.removeprefix("-")
    return f"+{text}" if value > 0 else text


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
