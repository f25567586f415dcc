"""The page of what has changed between two surveys, from change.tif, change.geojson and their record."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pyproj.exceptions import ProjError

from bumpymap.core import (
    CHANGE_KINDS,
    CLASS_NAMES,
    BadInputError,
    Each,
    Nullable,
    Number,
    parse_json,
    read_record,
    read_regular,
    shape_fault,
    utf8_path,
)
from bumpymap.layers import (
    CHANGE_COLOURS,
    COUNT,
    DIFFERENCE_RAMP,
    NORMAL_80,
    PLACE_SHAPE,
    MapFile,
    open_layer,
    outline_of,
    require_written,
)
from bumpymap.views.page.page import write_page
from bumpymap.views.page.site import PHOTO_BUDGET, RELIEF_BUDGET, RELIEF_SIDE, jpeg, read_photo, read_pixels, shaded
from bumpymap.views.page.tiles import ByteGrid, Spot, map_metres, packed
from bumpymap.views.pictures.drawing import DETAIL
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
_AGAIN = "Compare the surveys again"


@dataclass(frozen=True, slots=True)
class ChangeSite:
    """The changes between two surveys."""

    record: Mapping[str, Any]
    """The content of change.json."""
    spot: Spot
    kinds: NDArray[np.uint8]
    """Position in ``CHANGE_KINDS``, or ``NOT_COMPARED``: (rows, cols) of the page, north row first."""
    grids: tuple[ByteGrid, ...]
    places: tuple[dict[str, Any], ...]
    """The largest first: ``name``, its id in change.geojson; ``east`` and ``north``, m, the middle of its extent, and
    its ``size`` from west to east and from south to north, m; ``where``, a point in it, in the coordinates of
    change.geojson, and ``about``, its properties there."""
    degrees: bool
    """True if places are given as longitude and latitude; else in the survey's own coordinates."""
    still: str
    """The kinds, a data URI: for readers and printers without scripts."""
    below: Mapping[str, str]
    """From `_below`."""

    @classmethod
    def read(cls, folder: Path, record: Mapping[str, Any]) -> Self:
        """Read the files of a comparison.

        ``folder``: change.tif and change.geojson; ``record``: the content of change.json, which may not be there yet.
        Raises BadInputError: a file is missing, damaged, or was written by an earlier version.
        """
        try:
            with open_layer(folder / "change.tif", remedy=_AGAIN) as file:
                spot = Spot.of(file, record, _SIDE)
                step = max(spot.step, math.ceil(math.sqrt(record["counts"]["compared"] / _COMPARED)))
                while True:
                    spot = replace(spot, step=step)
                    kinds, d_height, d_c_r, least = _read(file, step)
                    grids = (
                        ByteGrid.of(("d_height", "height after minus before", "m", 2), d_height, "root"),
                        ByteGrid.of(("d_c_r", "ride cost C_r after minus before", "rad/m", 3), d_c_r, "root"),
                        ByteGrid.of(("least", "smallest heap or pit that would be found", "m³", 2), least, "log"),
                    )
                    taken = len(packed(kinds)) + sum(len(grid.text) for grid in grids)
                    if taken < _BUDGET or max(kinds.shape) < 100:
                        break
                    step *= 2
            places, degrees = _places(folder / "change.geojson", record)
            below = _below(record, spot)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, ProjError) as error:
            said = error if isinstance(error, ValueError) else repr(error)
            raise BadInputError(f"{folder} holds no comparison of this version: {said}. {_AGAIN}") from error
        except OSError as error:
            raise BadInputError(f"cannot read the files of the comparison in {folder}: {error}. {_AGAIN}") from error
        return cls(record, spot, kinds, grids, places, degrees, _still(kinds, spot), below)

    def area_of(self, tiles: int) -> float:
        """Return the area of some tiles, m2."""
        return tiles * self.spot.tile_size**2

    def map_record(self) -> dict[str, Any]:
        """Return what the script of the page needs, as plain JSON."""
        return {
            "name": "changes",
            "differences": True,
            **self.spot.record(),
            "ground": packed(self.kinds),
            "grids": [grid.record() for grid in self.grids],
            "places": [{key: place[key] for key in ("name", "east", "north", "size")} for place in self.places],
            **self.below,
        }

    @property
    def overlays(self) -> list[tuple[str, str, bool]]:
        """Keys and names of what is drawn under and over the colours, and whether it is at first."""
        below = [(key, key.capitalize(), True) for key in self.below]
        return below + ([("places", "Numbers of the places", True)] if self.places else [])


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
    """Return kinds and values on the grid of the page; of several tiles the change, or the farthest value."""
    if missing := [name for name in _BANDS if name not in file.descriptions]:
        raise ValueError(f"change.tif has no band {missing[0]}")
    bands = [file.descriptions.index(name) + 1 for name in _BANDS]
    rank = np.zeros(256, np.uint8)
    rank[list(_RANK)] = np.arange(1, len(_RANK) + 1)
    cols = -(-file.width // step)
    lines = step * max(1, _STRIP_TILES // (file.width * step))
    parts: list[tuple[NDArray[Any], ...]] = []
    for top in range(0, file.height, lines):
        count = min(lines, file.height - top)
        code, *values = file.read(bands, window=((top, top + count), (0, file.width)))
        known = np.isfinite(code)
        if known.any() and not set(np.unique(code[known])) <= set(range(len(CHANGE_KINDS))):
            raise ValueError("unknown kinds of change in change.tif")
        ranks = rank[np.where(known, code, NOT_COMPARED).astype(np.uint8)]
        rows = -(-count // step)
        room = ((0, rows * step - count), (0, cols * step - file.width))
        worst = np.pad(ranks, room).reshape(rows, step, cols, step).max(axis=(1, 3))
        farthest = [
            _farthest(np.pad(np.where(known, one, np.nan), room, constant_values=np.nan), step) for one in values
        ]
        parts.append((np.array([0, *_RANK], np.uint8)[worst], *farthest))
    kinds, *numbers = (np.concatenate(part) for part in zip(*parts, strict=True))
    for values in numbers:
        values[kinds == NOT_COMPARED] = np.nan
    return [kinds, *numbers]


def _farthest(values: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Return of each square of ``step`` x ``step`` tiles the value farthest from 0; NaN if it has none."""
    blocks = values.reshape(values.shape[0] // step, step, values.shape[1] // step, step)
    high, low = np.fmax.reduce(blocks, axis=(1, 3)), np.fmin.reduce(blocks, axis=(1, 3))
    return np.asarray(np.where(np.abs(high) >= np.abs(low), high, low), np.float32)


def _places(path: Path, record: Mapping[str, Any]) -> tuple[tuple[dict[str, Any], ...], bool]:
    """Return the largest places of change.geojson, and whether its coordinates are degrees."""
    collection = parse_json(read_regular(path).decode())
    features = collection["features"]
    if len(features) != record["counts"]["regions"]:
        raise ValueError("change.geojson and change.json are not of one comparison")
    largest = sorted(features, key=lambda feature: (-int(feature["properties"]["tiles"]), int(feature["id"])))
    metres, places = map_metres(record), []
    for one in largest[:_MOST_PLACES]:
        corners, where = outline_of(one["geometry"])
        corners = metres(corners)
        low, high = corners.min(axis=0), corners.max(axis=0)
        east, north = ((low + high) / 2).round(2).tolist()
        about = {"name": str(int(one["id"])), "about": one["properties"], "where": where}
        places.append(about | {"east": east, "north": north, "size": tuple((high - low).round(2).tolist())})
    return tuple(places), "local_coordinates" not in collection


def _still(kinds: NDArray[np.uint8], spot: Spot) -> str:
    """Return the kinds as one picture."""
    shown = kinds[spot.shown(_STILL_SIDE)]
    colours = np.full((256, 3), NOT_COMPARED_COLOUR, np.uint8)
    for code, colour in CHANGE_COLOURS.items():
        colours[code] = colour[:3]
    return jpeg(colours[shown], 150_000)


_MANIFEST = "change.json"
_SURVEY = {"folders": [str], "runs": [Each()]}
_SHAPE = PLACE_SHAPE | {
    "settings": {"fdr": Number(0, 1), "min_tiles": COUNT},
    "sources": {"before": _SURVEY, "after": _SURVEY},
    "vehicle": str,
    "calibration": str,
    "fit": {
        "widened": Each(Number()),
        "median_density_m2": (Nullable(Number()),) * 2,
        "versions": (Nullable(str),) * 2,
        "least_volume_m3": Nullable((Nullable(Number()),) * 2),
        "offset_taken_off_m": Number(),
        "offset_m": Nullable(Number()),
        "registration": Nullable(
            {
                "shift_m": Nullable((Number(), Number())),
                "shift_sd_m": Nullable((Number(), Number())),
                "shift_taken_off": bool,
                "tilt_deg": Nullable(Number()),
                "tilt_sd_deg": Nullable(Number()),
                "rises_towards_deg": Nullable(Number()),
                "tilt_taken_off": bool,
                "stable_tiles": COUNT,
            }
        ),
    },
    "counts": {
        **dict.fromkeys(("in_both", "compared", "changed", "regions", "passable_lost", "passable_won"), COUNT),
        "dropped_as_too_small": COUNT,
        "by_change": Each(COUNT),
        "volumes": dict.fromkeys(("heaped_m3", "heaped_sd_m3", "dug_m3", "dug_sd_m3"), Number()),
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
    if record is None or record.get("format") != "bumpymap-change":
        raise BadInputError(f"{folder / _MANIFEST} is not that of a comparison. Compare the surveys again")
    if fault := shape_fault(record, _SHAPE):
        raise BadInputError(f"{folder / _MANIFEST} is damaged: {fault}. Compare the surveys again")
    return record


def write_change_report(folder: Path, record: Mapping[str, Any], path: Path) -> None:
    """Write the page of the changes in a folder.

    ``folder``: change.tif and change.geojson; ``record``: the content of change.json, which need not be there yet.
    Raises BadInputError: a file cannot be read; OutputError: the page cannot be written.
    """
    site = ChangeSite.read(folder, record)
    runs = [record["sources"][side]["runs"][0] for side in _SIDES]
    classes = [*(f"{code} {name}" for code, name in enumerate(CLASS_NAMES)), "not known"]
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
    write_page(
        path,
        "change.html",
        name=_title(runs),
        site=site,
        class_names=classes,
        class_rows=[
            (name, *map(whole, row)) for name, row in zip(classes, record["classes"]["tiles_before_after"], strict=True)
        ],
        kind_rows=_kind_rows(site),
        place_rows=[_place_row(site, place) for place in site.places],
        ramp_colours=DIFFERENCE_RAMP,
        not_compared_colour=NOT_COMPARED_COLOUR,
        survey_rows=_survey_rows(record["fit"], runs),
        registration=_registration(record["fit"]["registration"]),
        least=least_volume_text(record["fit"]["least_volume_m3"]),
        volumes=volumes_text(record["counts"]["volumes"]),
        data={"maps": [site.map_record()], "codes": codes},
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


def _kind_rows(site: ChangeSite) -> list[tuple[Any, ...]]:
    """Return the number and area of the tiles of each kind of change."""
    counts = site.record["counts"]
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
    most = site.area_of(compared + apart)
    return [(name, part, area(site.area_of(tiles), most), whole(tiles)) for name, part, tiles in entries]


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


def _place_row(site: ChangeSite, place: Mapping[str, Any]) -> tuple[Any, ...]:
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
        area(site.area_of(tiles), site.area_of(int(site.places[0]["about"]["tiles"]))),
        whole(tiles),
        signed(about["d_height"], 2),
        f"{low} to {high}",
        signed(about["d_largest"], 2),
        f"{signed(about['volume_m3'], 1)} ± {number(NORMAL_80 * about['volume_sd_m3'], 1)}",
        number(about["c_r_before"], 3),
        number(about["c_r_after"], 3),
        signed(about["d_c_r"], 3),
        *(f"{value:.{6 if site.degrees else 1}f}" for value in place["where"]),
    )
