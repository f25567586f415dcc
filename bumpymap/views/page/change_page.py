"""The page of what has changed between two surveys, from change.tif, change.geojson and their record."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CHANGE_KINDS,
    CLASS_NAMES,
    NORMAL_80,
    BadInputError,
    parse_json,
    read_regular,
    utf8_path,
)
from bumpymap.layers import (
    CHANGE_COLOURS,
    DIFFERENCE_RAMP,
    MapFile,
    open_layer,
    outline_of,
    require_written,
)
from bumpymap.views.light import DETAIL
from bumpymap.views.page.page import write_page
from bumpymap.views.page.site import PHOTO_BUDGET, RELIEF_BUDGET, RELIEF_SIDE, jpeg, read_photo, read_pixels, shaded
from bumpymap.views.page.tiles import ByteGrid, Spot, map_metres, packed
from bumpymap.views.words import area, least_volume_text, number, share, shares, signed, volumes_text, whole

NOT_COMPARED = 16
"""Value of ``kinds`` where the surveys could not be compared."""
NOT_COMPARED_COLOUR = (150, 150, 150)
"""Of such ground: darker than ground that has not changed."""
_RANK = (NOT_COMPARED, 1, 3, 5, 4, 2)
"""Order of the kinds in a pixel of several tiles: each counts before those to its left and before unchanged tiles."""
_SIDE = 1_500
"""Most pixels of the grids along a side: chosen."""
_BUDGET = 1_300_000
"""Most characters of the grids: a page has 2 MB at most."""
_COMPARED = 400_000
"""Most pixels of the grids with a value: some three bytes of the page each."""
_STRIP_TILES = 1_000_000
"""Most tiles to read at a time."""
_STILL_SIDE = 700
"""Longer side of the picture for pages without scripts, pixels: chosen."""
_MOST_PLACES = 200
"""Most places on the map and in the table, the largest."""
_BANDS = ("changed", "d_height", "d_c_r", "least_volume")


def _read_grids(path: Path, record: Mapping[str, Any]) -> tuple[Spot, NDArray[np.uint8], tuple[ByteGrid, ...]]:
    """Return where the page shows change.tif, its kinds on the page's grid, and its values."""
    with open_layer(path) as file:
        spot = Spot.of(file, record, _SIDE)
        step = max(spot.step, math.ceil(math.sqrt(record["counts"]["compared"] / _COMPARED)))
        while True:
            kinds, d_height, d_c_r, least = _read(file, step)
            grids = (
                ByteGrid.of(("d_height", "height after minus before", "m", 2), d_height, "root"),
                ByteGrid.of(("d_c_r", "ride cost C_r after minus before", "rad/m", 3), d_c_r, "root"),
                ByteGrid.of(("least", "smallest heap or pit that would be found", "m³", 2), least, "log"),
            )
            if len(packed(kinds)) + sum(len(grid.text) for grid in grids) < _BUDGET or max(kinds.shape) < 100:
                return replace(spot, step=step), kinds, grids
            step *= 2


def _below(record: Mapping[str, Any], spot: Spot) -> dict[str, str]:
    """Return the photo of a survey, else its relief, as a data URI by its key; nothing if the maps are there no more.

    That of the later survey is taken first. A map is the one that was compared if the checksum of the file says so.
    """
    for key, file in (("photo", MapFile.PHOTO), ("relief", MapFile.HEIGHTMAP)):
        for side in reversed(_SIDES):
            source = record["sources"][side]
            folder = Path(source["folders"][0])
            with suppress(BadInputError), utf8_path(folder) as readable:
                require_written(readable, source["runs"][0], (file,))
                if key == "photo":
                    return {key: jpeg(read_photo(readable / file, spot), PHOTO_BUDGET)}
                return {key: jpeg(shaded(read_pixels(readable / file, spot, RELIEF_SIDE), spot), RELIEF_BUDGET)}
    return {}


def _read(file: Any, step: int) -> list[NDArray[Any]]:
    """Return kinds, a position in ``CHANGE_KINDS`` or ``NOT_COMPARED``, and values on the grid of the page.

    Of several tiles it is the change, or the farthest value.
    """
    bands = [file.descriptions.index(name) + 1 for name in _BANDS]
    rank = np.zeros(256, np.uint8)
    rank[list(_RANK)] = np.arange(1, len(_RANK) + 1)
    lines = step * max(1, _STRIP_TILES // (file.width * step))
    parts: list[tuple[NDArray[Any], ...]] = []
    for top in range(0, file.height, lines):
        code, *values = file.read(bands, window=((top, min(top + lines, file.height)), (0, file.width)))
        known = np.isfinite(code)
        ranks = rank[np.where(known, code, NOT_COMPARED).astype(np.uint8)]
        worst = _blocks(ranks, step, 0).max(axis=(1, 3))
        farthest = [_farthest(_blocks(np.where(known, one, np.nan), step, np.nan)) for one in values]
        parts.append((np.array([0, *_RANK], np.uint8)[worst], *farthest))
    kinds, *numbers = (np.concatenate(part) for part in zip(*parts, strict=True))
    return [kinds, *(np.where(kinds == NOT_COMPARED, np.nan, values) for values in numbers)]


def _blocks(values: NDArray[Any], step: int, filling: float) -> NDArray[Any]:
    """Return values of tiles in squares of ``step`` x ``step``, (rows, step, cols, step), filled up at the edge."""
    rows, cols = (-(-size // step) for size in values.shape)
    room = [(0, count * step - size) for count, size in zip((rows, cols), values.shape, strict=True)]
    return np.pad(values, room, constant_values=filling).reshape(rows, step, cols, step)


def _farthest(blocks: NDArray[Any]) -> NDArray[np.float32]:
    """Return of each square the value farthest from 0; NaN if it has none."""
    high, low = np.fmax.reduce(blocks, axis=(1, 3)), np.fmin.reduce(blocks, axis=(1, 3))
    return np.asarray(np.where(np.abs(high) >= np.abs(low), high, low), np.float32)


def _places(path: Path, record: Mapping[str, Any]) -> tuple[list[dict[str, Any]], bool]:
    """Return the largest places of change.geojson, the largest first, and whether its coordinates are degrees.

    ``name`` is its id there; ``east`` and ``north``, m, the middle of its extent, and ``size`` that from west to east
    and from south to north, m; ``where``, a point in it, in the coordinates of the file, and ``about``, its properties.
    """
    collection = parse_json(read_regular(path).decode())
    largest = sorted(collection["features"], key=lambda one: (-int(one["properties"]["tiles"]), int(one["id"])))
    metres, places = map_metres(record), []
    for one in largest[:_MOST_PLACES]:
        corners, where = outline_of(one["geometry"])
        corners = metres(corners)
        low, high = corners.min(axis=0), corners.max(axis=0)
        east, north = ((low + high) / 2).round(2).tolist()
        about = {"name": str(int(one["id"])), "about": one["properties"], "where": where}
        places.append(about | {"east": east, "north": north, "size": tuple((high - low).round(2).tolist())})
    return places, "local_coordinates" not in collection


def _still(kinds: NDArray[np.uint8], spot: Spot) -> str:
    """Return the kinds as one picture."""
    shown = kinds[spot.shown(_STILL_SIDE)]
    colours = np.full((256, 3), NOT_COMPARED_COLOUR, np.uint8)
    for code, colour in CHANGE_COLOURS.items():
        colours[code] = colour[:3]
    return jpeg(colours[shown], 150_000)


def write_change_report(folder: Path, record: Mapping[str, Any], path: Path) -> None:
    """Write the page of the changes in a folder.

    ``folder``: change.tif and change.geojson; ``record``: the content of change.json, which need not be there yet.
    Raises OutputError: the page cannot be written.
    """
    spot, kinds, grids = _read_grids(folder / "change.tif", record)
    places, degrees = _places(folder / "change.geojson", record)
    below = _below(record, spot)
    runs = [record["sources"][side]["runs"][0] for side in _SIDES]
    classes = [*(f"{code} {name}" for code, name in enumerate(CLASS_NAMES)), "not known"]
    overlays = [(key, key.capitalize(), True) for key in below]
    codes = {
        "unknownFrom": NOT_COMPARED,
        "classes": list(CHANGE_KINDS),
        "reasons": ["not compared: may have changed or not"],
        "outside": "outside of what the surveys share: not compared",
        "classColours": [CHANGE_COLOURS[code] for code in range(len(CHANGE_KINDS))],
        "ramp": DIFFERENCE_RAMP,
        "unknownColour": NOT_COMPARED_COLOUR,
        "strength": DETAIL,
    }
    drawn = {
        "name": "changes",
        "differences": True,
        **spot.record(),
        "ground": packed(kinds),
        "grids": [grid.record() for grid in grids],
        "places": [{key: place[key] for key in ("name", "east", "north", "size")} for place in places],
        **below,
    }
    write_page(
        path,
        "change.html",
        name=_title(runs),
        record=record,
        spot=spot,
        grids=[grid for grid in grids if grid.is_known],
        places=places,
        degrees=degrees,
        still=_still(kinds, spot),
        overlays=[*overlays, ("places", "Numbers of the places", True)] if places else overlays,
        class_names=classes,
        class_rows=[
            (name, *map(whole, row)) for name, row in zip(classes, record["classes"]["tiles_before_after"], strict=True)
        ],
        kind_rows=_kind_rows(record["counts"], spot.tile_size**2),
        place_rows=[_place_row(place, places[0], spot.tile_size**2, degrees=degrees) for place in places],
        ramp_colours=DIFFERENCE_RAMP,
        not_compared_colour=NOT_COMPARED_COLOUR,
        survey_rows=_survey_rows(record["fit"], runs),
        registration=_registration(record["fit"]["registration"]),
        least=least_volume_text(record["fit"]["least_volume_m3"]),
        volumes=volumes_text(record["counts"]["volumes"]),
        data={"maps": [drawn], "codes": codes},
    )


_SIDES = ("before", "after")


def _title(runs: list[Mapping[str, Any]]) -> str:
    """Return what the two surveys are called, by what differs: their names, else the dates of their files."""
    names, days = [str(run["survey"]["name"]) for run in runs], [_dates(run) for run in runs]
    if names[0] != names[1]:
        return " to ".join(names)
    dated = None not in days and days[0] != days[1]
    return f"{names[0]}: {'files written on {} and {}'.format(*days) if dated else 'before to after'}"


def _dates(run: Mapping[str, Any]) -> str | None:
    dates = run["survey"]["dates"]
    if not dates:
        return None
    return str(dates[0]) if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"


_MEANING = {
    "not changed": "no change was found; one smaller than the noise stays unseen",
    "ground changed, ride as before": "the ground has another height or shape; its ride costs differ by less than half",
    "rougher": "the ground has changed and is rougher to ride on",
    "smoother": "the ground has changed and is smoother to ride on",
    "ground changed, ride unknown": "the ground has changed; the ride over it is not known in one survey or in both",
    "ground changed, ride not decided": "the ground has changed; the ride may have, within what the points leave open",
}


_APART = "too few places where both have points: may have changed or not"


def _kind_rows(counts: Mapping[str, Any], tile_m2: float) -> list[tuple[Any, ...]]:
    """Return the number and area of the tiles of each kind of change."""
    compared, apart = int(counts["compared"]), int(counts["in_both"] - counts["compared"])
    found = [int(counts["by_change"][kind]) for kind in CHANGE_KINDS]
    entries = [
        *(
            ({"text": name, "meaning": _MEANING[name]}, part, tiles)
            for name, part, tiles in zip(CHANGE_KINDS, shares(found), found, strict=True)
        ),
        ("compared", share(compared, compared), compared),
        ({"text": "in both surveys, not compared", "meaning": _APART}, share(apart, 0), apart),
    ]
    most = tile_m2 * (compared + apart)
    return [(name, part, area(tile_m2 * tiles, most), whole(tiles)) for name, part, tiles in entries]


def _survey_rows(fit: Mapping[str, Any], runs: list[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    inputs = [run["inputs"] for run in runs]
    return [
        ("name", *(run["survey"]["name"] for run in runs)),
        ("files written on", *(_dates(run) or "not stated" for run in runs)),
        ("files", *(whole(len(items)) for items in inputs)),
        ("points in the files", *(whole(sum(int(item.get("points") or 0) for item in items)) for items in inputs)),
        ("points per m² where both have tiles, median", *(number(value, 1) for value in fit["median_density_m2"])),
        ("made by version", *(str(version or "not stated") for version in fit["versions"])),
    ]


def _registration(found: Mapping[str, Any] | None) -> tuple[str, str]:
    """Return what is said of a shift in plan and of a tilt."""
    if found is None:
        return ("not looked for, as asked",) * 2
    taken = {True: "taken off", False: "not taken off"}
    shift, tilt = "not known: the ground has too little relief to tell", "not known"
    if found["shift_m"] is not None:
        east, north = (f"{signed(value, 3)} m" for value in found["shift_m"])
        error = f"± {max(found['shift_sd_m']):.3f} m"
        shift = f"{east} east, {north} north ({error}), {taken[found['shift_taken_off']]}"
    if found["tilt_deg"] is not None:
        error, towards = f"± {max(found['tilt_sd_deg'], 1e-4):.4f}°", f"{found['rises_towards_deg']:.0f}° from north"
        tilt = f"{found['tilt_deg']:.4f}° ({error}), rising towards {towards}, {taken[found['tilt_taken_off']]}"
    return shift, tilt


def _place_row(
    place: Mapping[str, Any], largest: Mapping[str, Any], tile_m2: float, *, degrees: bool
) -> tuple[Any, ...]:
    """Return the cells of a place: its number with the ride of its tiles, sizes, differences, a point in it."""
    about = place["about"]
    tiles = int(about["tiles"])
    kinds = [
        (name.removeprefix("ground changed, ride "), int(about[name.replace(",", "").replace(" ", "_")]))
        for name in CHANGE_KINDS[1:]
    ]
    found = [(name, count) for name, count in kinds if count]
    ride = found[0][0] if len(found) == 1 else ", ".join(f"{name} in {whole(count)}" for name, count in found)
    low, high = (signed(about[name], 2) for name in ("d_height_lowest", "d_height_highest"))
    return (
        {"text": place["name"], "meaning": ride},
        area(tile_m2 * tiles, tile_m2 * int(largest["about"]["tiles"])),
        whole(tiles),
        signed(about["d_height"], 2),
        f"{low} to {high}",
        signed(about["d_largest"], 2),
        f"{signed(about['volume_m3'], 1)} ± {number(NORMAL_80 * about['volume_sd_m3'], 1)}",
        number(about["c_r_before"], 3),
        number(about["c_r_after"], 3),
        signed(about["d_c_r"], 3),
        *(f"{value:.{6 if degrees else 1}f}" for value in place["where"]),
    )
