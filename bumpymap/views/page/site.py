"""One folder of layers as a page shows it: its record, its ways, and the ground under the colours."""

import base64
import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.ImageFile import ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from pyproj import Transformer
from pyproj.exceptions import ProjError

from bumpymap.core import (
    CANOPY,
    CLASS_NAMES,
    FAIL_SHARE,
    FREE,
    NO_CLASS,
    OBSTACLE,
    SEEN_NUMBERS,
    BadInputError,
    Barred,
    Nullable,
    Number,
    PageSettings,
    UsageError,
    read_regular,
    shape_fault,
    stated_crs,
)
from bumpymap.layers import (
    CLASS_COLOURS,
    CLOSED_COLOUR,
    MID_GREY,
    STEP_LINE,
    UNKNOWN_COLOUR,
    UNKNOWN_OBJECT,
    MapFile,
    MapSummary,
    RideScale,
    class_limits,
    class_ranges,
    on_islands,
    open_layer,
    read_averaged,
    read_colours,
)
from bumpymap.views.light import LEVEL, grey_of, hard_light, levelled, light_of
from bumpymap.views.page.charts import profile_places
from bumpymap.views.page.tiles import (
    NO_POINTS,
    STEPS,
    UNKNOWN_FROM,
    ByteGrid,
    PageTiles,
    Spot,
    block_means,
    map_metres,
    packed,
)

_STRIP_PIXELS = 16_000_000
"""Most pixels of obstacle.tif to read at a time."""
_DARKEST = 30
"""Brightness of ground that faces away from the light, of 255: chosen."""
_WORST = (FREE, CANOPY, UNKNOWN_OBJECT, STEP_LINE, OBSTACLE)
"""Order of the states in a pixel: each counts before those to its left."""
_QUALITIES = (72, 55, 40, 25)
"""Of JPEG, per cent, from the first that is tried: chosen."""


def finer(spot: Spot, side: int) -> int:
    """Return the number of pixels of a picture along each pixel of the page's grid, with at most ``side`` in all."""
    return 1 if spot.step > 1 else max(1, min(spot.pixels, side // max(spot.cols, spot.rows)))


def read_pixels(
    path: Path, spot: Spot, side: int, read: Callable[..., NDArray[Any]] = read_averaged
) -> NDArray[np.float32]:
    """Read a raster of the pixels of heightmap.tif, ``side`` along a side at most, or one for each of the page's grid.

    The page may show a part of the raster. ``read`` returns the pixels of a window in another shape, (..., rows, cols),
    as `read_averaged`. Returns float32 (..., rows, cols): NaN where there is no point.
    """
    factor = spot.pixels
    while factor > finer(spot, side):  # half and half again: what overviews hold, or a little less
        factor //= 2
    with open_layer(path) as file:
        place, bands = file.transform, read(file, (1, 1)).shape[:-2]
        left = round((spot.west / spot.unit - place.c) / place.a)
        top = round((spot.north / spot.unit - place.f) / place.e)
        found = np.full([*bands, *(pixels * factor for pixels in spot.shape)], np.nan, np.float32)
        for line, lines, rows in _spans(spot.rows, spot.step):
            for column, columns, cols in _spans(spot.cols, spot.step):
                high, wide = (
                    (start + first * spot.pixels, start + (first + tiles) * spot.pixels)
                    for start, first, tiles in ((top, line, rows * lines), (left, column, cols * columns))
                )
                row, col = line // spot.step * factor, column // spot.step * factor
                place = np.s_[..., row : row + lines * factor, col : col + columns * factor]
                found[place] = read(file, (lines * factor, columns * factor), (high, wide))
    return found


def shaded(heights: NDArray[np.float32], spot: Spot) -> NDArray[np.uint8]:
    """Return the light on heights from `read_pixels`; ``MID_GREY`` where the ground is level or not known."""
    side_m = spot.metres * spot.shape[0] / heights.shape[0]
    bright = np.clip(light_of(heights, (side_m, side_m)) * (MID_GREY / LEVEL), _DARKEST, 255)
    return np.rint(bright).astype(np.uint8)


_HOLE = 8
"""Side of the squares, pixels, whose mean colour stands for pixels of a photo without one."""


def read_photo(path: Path, spot: Spot) -> NDArray[np.uint8]:
    """Read photo.tif as `read_pixels` and level it, (rows, cols, 3); holes have the mean around them."""
    found = np.moveaxis(levelled(np.moveaxis(read_pixels(path, spot, _PHOTO_SIDE, read_colours), 0, -1)), -1, 0)
    known = np.isfinite(found[0])
    count = _square_sums(known)
    out = np.empty((*known.shape, 3), np.uint8)
    for band, values in enumerate(found):
        values[~known] = 0.0
        mean = np.where(count > 0, _square_sums(values) / np.maximum(count, 1), MID_GREY)
        around = np.rint(mean).astype(np.uint8).repeat(_HOLE, axis=0).repeat(_HOLE, axis=1)
        out[..., band] = np.where(known, np.rint(values).astype(np.uint8), around[: len(known), : known.shape[1]])
    return out


def _square_sums(values: NDArray[Any]) -> NDArray[Any]:
    """Return the sums of squares of ``_HOLE`` x ``_HOLE`` pixels; those at the south and east edges may be smaller."""
    rows, cols = (np.arange(0, size, _HOLE) for size in values.shape)
    return np.asarray(np.add.reduceat(np.add.reduceat(values, rows, axis=0, dtype=np.float64), cols, axis=1))


def _spans(count: int, step: int) -> list[tuple[int, int, int]]:
    """Divide ``count`` tiles into those of whole pixels of ``step`` tiles, and those of the last pixel.

    Returns first tile, number of pixels, and tiles in each of them.
    """
    whole = count // step
    parts = [(0, whole, step), (whole * step, 1, count - whole * step)]
    return [(first, pixels, tiles) for first, pixels, tiles in parts if pixels and tiles]


def object_grid(folder: Path, tiles: PageTiles, side: int) -> NDArray[np.uint8]:
    """Return the worst of FREE, CANOPY, UNKNOWN_OBJECT, STEP_LINE and OBSTACLE in each pixel; else 255.

    It has at most ``side`` pixels along a side; on maps so large that each of them spans a tile or more, the tiles tell
    of obstacles alone.
    """
    spot = tiles.spot
    factor = finer(spot, side)
    if factor == 1:
        return tiles.objects
    rows, cols = spot.rows * factor, spot.cols * factor
    rank = np.zeros(256, np.uint8)
    rank[list(_WORST)] = np.arange(1, len(_WORST) + 1)
    canvas = np.empty((rows, cols), np.uint8)
    starts = np.arange(cols) * spot.pixels // factor
    lines = max(1, _STRIP_PIXELS // max(1, spot.cols * spot.pixels**2))  # tiles
    with open_layer(folder / MapFile.OBSTACLE) as file:
        for top in range(0, spot.rows, lines):
            count = min(lines, spot.rows - top)
            window = ((top * spot.pixels, (top + count) * spot.pixels), (0, file.width))
            found = rank[file.read(1, window=window)]
            down = np.maximum.reduceat(found, np.arange(count * factor) * spot.pixels // factor, axis=0)
            canvas[top * factor : (top + count) * factor] = np.maximum.reduceat(down, starts, axis=1)
    return np.array([NO_CLASS, *_WORST], np.uint8)[canvas]


def _uri(buffer: io.BytesIO, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(buffer.getvalue()).decode()}"


def jpeg(picture: NDArray[np.uint8], most: int) -> str:
    """Return a picture as a data URI of at most ``most`` characters, or of 64 pixels along a side.

    It is stored more coarsely, then halved in size, until it fits.
    """
    image = Image.fromarray(picture)
    while True:
        for quality in _QUALITIES:
            buffer = io.BytesIO()
            image.save(buffer, "JPEG", quality=quality)
            text = _uri(buffer, "jpeg")
            if len(text) <= most:
                return text
        if max(image.size) <= 64:
            return text
        image = image.resize((max(1, image.width // 2), max(1, image.height // 2)))


_MOST_BYTES, _MOST_PIXELS = 5_000_000, 50_000_000
"""Of the file of a picture that is read, and of the picture."""
_PICTURES: dict[bytes, type[ImageFile]] = {b"\x89PNG": PngImageFile, b"\xff\xd8\xff": JpegImageFile}
"""By the first bytes of a file. `Image.open` would warn of a large picture, or raise an error of no usual kind."""
UNREADABLE = (OSError, ValueError, SyntaxError)
"""Errors of reading a picture."""
_LOGO_SIDES = (480, 160)
"""Largest width and height on the page, pixels."""


def open_picture(path: Path) -> ImageFile:
    """Open a PNG or JPEG of at most 5 MB and 50 million pixels by its header; its pixels are decoded later.

    Raises one of ``UNREADABLE``.
    """
    content = read_regular(path, _MOST_BYTES)
    kind = next((each for start, each in _PICTURES.items() if content.startswith(start)), None)
    if kind is None:
        raise ValueError("it is no PNG or JPEG")
    picture = kind(io.BytesIO(content))
    if picture.width * picture.height > _MOST_PIXELS:
        raise ValueError(f"it has {picture.width:,} x {picture.height:,} pixels")
    return picture


def page_header(settings: PageSettings) -> dict[str, str]:
    """Return what the header of a page says: the texts that are given, and the logo as a data URI.

    The logo is made again from its pixels, so that nothing else that is in the file comes with it. Raises UsageError:
    the logo cannot be taken, see `open_picture`, or is a link.
    """
    found = {name: text for name in ("title", "client", "operator", "note") if (text := getattr(settings, name))}
    if (path := settings.logo) is None:
        return found
    remedy = f"Give a PNG or JPEG of at most {_MOST_BYTES / 1e6:g} MB and {_MOST_PIXELS / 1e6:g} million pixels"
    fault = f"{path} is not taken as a logo: %s. {remedy} as `page.logo`"
    if path.is_symlink():
        raise UsageError(fault % "it is a link")
    try:
        with open_picture(path) as picture:
            shown = picture.convert("RGBA")
    except UNREADABLE as error:
        raise UsageError(fault % (getattr(error, "strerror", None) or error)) from error
    shown.thumbnail(_LOGO_SIDES)
    buffer = io.BytesIO()
    shown.save(buffer, "PNG", optimize=True)
    return found | {"logo": _uri(buffer, "png")}


@dataclass(frozen=True, slots=True)
class DrawnWay:
    """One way over the map."""

    name: str
    lines: tuple[NDArray[np.float64], ...]
    """Each (n, 2), m: easting and northing in the survey's CRS."""
    figures: Mapping[str, Any]
    """The properties of its line in route.geojson."""
    letter: str
    """By which the page names it on the map and in its text."""
    profile: Mapping[str, NDArray[np.float64]]
    """Columns of profile.csv by their names, and ``east`` and ``north``, m, as the lines; (n,) each, NaN where unknown,
    ``_PLACES`` places at most. Empty if there is none."""


WAY_FIGURES = (
    *(("length_m", 0), ("cost_m", 0), ("detour", 2), ("seconds", 0), ("c_r_mean", 3), ("c_r_line", 3)),
    *(("c_r_max", 3), ("p_arrives", 2), ("unknown_m", 0), ("obstacle_m", 1), ("tight_turns_deg", 0)),
    *(("climb_m", 1), ("descent_m", 1)),
)
"""Figures of a way on a page, properties of its line, with their decimals."""
_WAY_SHAPE = {"name?": Nullable(str), "why?": Nullable(str), "seen?": Nullable(str)} | {
    f"{key}?": Nullable(Number()) for key in (*(key for key, _ in WAY_FIGURES), *SEEN_NUMBERS)
}


def read_ways(folder: Path, record: Mapping[str, Any]) -> tuple[DrawnWay, ...]:
    """Read the ways of a folder, or of a file, that `bumpymap route` wrote.

    ``folder``: the folder, or route.geojson itself; ``record``: the content of run.json of the map: its CRS and units.
    Raises BadInputError: there is no route.geojson, or it is not one of `bumpymap route`, or its coordinates are not
    those of the map.
    """
    path = folder / "route.geojson" if folder.is_dir() else folder
    remedy = "Give the folder of a route from one place to another, which `bumpymap route` wrote, as `route`"
    if not path.is_file():
        raise BadInputError(f"there is no file {path}. {remedy}")
    try:
        ways = tuple(_ways(path, record))
    except (OSError, ValueError, ProjError, csv.Error) as error:
        raise BadInputError(f"cannot read {path} as a route: {error}. {remedy}") from error
    if not ways:
        raise BadInputError(f"{path} holds no way. {remedy}")
    return ways


def _ways(path: Path, record: Mapping[str, Any]) -> Iterator[DrawnWay]:
    from bumpymap.layers import geojson_features, line_parts

    metres, profiles = map_metres(record), _read_profiles(path.with_name("profile.csv"))
    unit = float(record["metres_per_unit"]["horizontal"])
    found = [each for each in geojson_features(path)[0] if each[0].geom_type in {"LineString", "MultiLineString"}]
    for place, (geometry, about) in enumerate(found):
        if fault := shape_fault(about, _WAY_SHAPE):
            raise ValueError(fault)
        lines = tuple(np.round(metres(part), 2) for part in line_parts(geometry))
        letter = chr(ord("A") + place) if place < 26 else str(place + 1)
        profile = profiles.get(name := about.get("name") or "way", {})
        profile |= {key: unit * profile[axis] for key, axis in (("east", "x"), ("north", "y")) if profile}
        yield DrawnWay(name, lines, about, letter, profile)


def _read_profiles(path: Path) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Read profile.csv, if it is there, by the names of its ways."""
    if not path.is_file():
        return {}
    rows: dict[str, list[list[float]]] = {}
    with path.open(encoding="utf-8", newline="") as file:
        lines = csv.DictReader(file)
        if missing := {"route", *_PROFILE} - set(lines.fieldnames or ()):
            raise ValueError(f"{path.name} has no column {min(missing)}")
        for line in lines:
            rows.setdefault(line["route"], []).append([float(line[key] or "nan") for key in _PROFILE])
    found = {}
    for name, points in rows.items():
        shown = np.array(points)[np.unique(np.linspace(0, len(points) - 1, _PLACES).astype(int))]
        if not np.isfinite(shown[:, : _PROFILE.index("z_m")]).all():
            raise ValueError(f"{path.name} has a point without a place")
        found[name] = dict(zip(_PROFILE, shown.T, strict=True))
    return found


_PLACES = 400
"""Most places of a profile: chosen."""
_PROFILE = ("distance_m", "x", "y", "z_m", "c_r", "c_r_low", "c_r_high")
"""Columns of profile.csv that a page shows."""


_BUDGET = 1_700_000
"""Characters for the map of a page; its text takes some 60,000 more."""
_SIDE = 1_500
"""Most pixels of a grid of tiles, or of objects, along a side."""
RELIEF_SIDE, RELIEF_BUDGET = 1_000, 340_000
"""Most pixels of the relief along a side (what GDAL reads from an overview then takes half the time of 1500), and most
characters."""
_TILES = 220_000
"""Most pixels with a tile in the grids: six bytes or so each."""
_PHOTO_SIDE, PHOTO_BUDGET = 1_400, 550_000
"""Most pixels of the photo along a side, and most characters."""
_STILL_SIDE = 700
"""Longer side of the picture for pages without scripts, pixels: chosen."""
RAMP = ("#f7d98b", "#fba867", "#f1735c", "#d64a6c", "#a8307d", "#751f81", "#440f76")
"""Colours from the least to the most of a value: lightness falls evenly, so that they can be distinguished in grey."""
_BLANK = (255, 255, 255)
"""Colour of places without points."""


@dataclass(frozen=True, slots=True)
class Site:
    """One map of a page."""

    name: str
    record: Mapping[str, Any]
    """The content of run.json."""
    summary: MapSummary
    tiles: PageTiles
    grids: tuple[ByteGrid, ...]
    """Values of tiles."""
    objects: NDArray[np.uint8]
    """See `object_grid`."""
    packed_objects: str
    relief: str
    """Shaded relief, a data URI."""
    photo: str | None
    """The colours of the points, a data URI; None if they have none."""
    still: str
    """The ride cost in the light of the photo or the relief, a data URI: for readers and printers without scripts."""
    degrees: list[list[float]] | None
    """Longitude and latitude of the corners of the map: north-west, north-east, south-west, south-east.

    None without a CRS, or where these are not known.
    """
    ways: tuple[DrawnWay, ...] = ()
    stretches: Sequence[Mapping[str, Any]] = ()
    """Stretches of real drives over the map, as the script of the page needs them."""

    @classmethod
    def read(
        cls,
        folder: Path,
        record: Mapping[str, Any],
        ways: tuple[DrawnWay, ...] = (),
        *,
        stretches: Sequence[Mapping[str, Any]] = (),
        wait: Callable[..., None] = lambda *_: None,
    ) -> Self:
        """Read a folder of layers.

        ``folder``: complete layers of a run; ``record``: the content of its run.json, which may not be there yet;
        ``ways``: ways to draw; ``stretches``: stretches of real drives, from `write_check_page`; ``wait``: waits until
        layers, given their names, are in the folder. Raises BadInputError: a file is missing, damaged, or was written
        by an earlier version.
        """
        wait(MapFile.CLASS, MapFile.TILES)
        summary = MapSummary.of(record["counts"])
        with open_layer(folder / MapFile.CLASS) as file:
            spot = Spot.of(file, record, _SIDE)
        step = max(spot.step, int(np.ceil(np.sqrt(summary.tiles / _TILES))))
        while True:
            spot = replace(spot, step=step)
            tiles = PageTiles.read(folder, record, spot)
            wait(MapFile.HEIGHTMAP)
            heights = read_pixels(folder / MapFile.HEIGHTMAP, spot, RELIEF_SIDE)
            grids = (
                ByteGrid.of(("c_r", "ride cost C_r", "rad/m", 3), tiles.c_r, "log"),
                ByteGrid.of(("p_fail", "chance of failure", "", 3), tiles.p_fail, limits=(0.0, 1.0)),
                ByteGrid.of(("slope", "slope", "°", 1), tiles.slope),
                ByteGrid.of(("cost", "cost of a metre", "m", 2), tiles.cost, "log"),
                ByteGrid.of(("height", "height", "m", 1), block_means(heights, spot.shape)),
            )
            taken = sum(len(grid.text) for grid in grids)
            if taken < 0.7 * _BUDGET or max(spot.shape) < 100:
                break
            step *= 2
        light = shaded(heights, spot)
        relief = jpeg(light, RELIEF_BUDGET)
        wait(MapFile.PHOTO)
        colours = folder / MapFile.PHOTO
        photo = read_photo(colours, spot) if colours.is_file() else None
        picture = None if photo is None else jpeg(photo, PHOTO_BUDGET)
        side = _SIDE
        wait(MapFile.OBSTACLE)
        while True:
            objects = object_grid(folder, tiles, side)
            text = packed(objects)
            if len(text) < 0.2 * _BUDGET or side < 100:
                break
            side //= 2
        still = _still(tiles, RideScale.of(record), light if photo is None else photo)
        degrees = None if record["crs"] is None else _corners(record["crs"]["wkt"], spot)
        shown = (tiles, grids, objects, text, relief, picture, still, degrees)
        return cls(str(record["survey"]["name"]), record, summary, *shown, ways, stretches)

    @property
    def ground(self) -> float:
        """Area of the tiles with points, m2."""
        return self.summary.tiles * self.tile_area

    @property
    def header(self) -> Mapping[str, str]:
        """Texts and logo of `page_header`; the operator is the provider unless another one is given."""
        provider = self.record["settings"].get("provider")
        return ({"operator": provider} if provider else {}) | (self.record.get("page") or {})

    @property
    def tile_area(self) -> float:
        """Area of a tile, m2."""
        return self.tiles.spot.tile_size**2

    @property
    def objects_known(self) -> bool:
        """True if anything is known to be free of objects or to hold one."""
        return bool(((self.objects == FREE) | (self.objects == OBSTACLE)).any())

    @property
    def island_colours(self) -> NDArray[np.float64]:
        """Colours of the classes on islands, (4, 3) whole numbers."""
        colours = np.array([CLASS_COLOURS[code][:3] for code in range(len(CLASS_NAMES))])
        return np.rint(on_islands(colours)).astype(int)

    @property
    def layers(self) -> list[tuple[str, str]]:
        """Keys and names of the colourings of the map: those of which something is known."""
        names = {"c_r": "Ride", "p_fail": "Chance of failure", "slope": "Slope", "cost": "Cost of a metre"}
        known = {grid.key for grid in self.grids if grid.is_known}
        layers = [(key, name) for key, name in names.items() if key in known]
        layers.insert("c_r" in known, ("class", "Class"))
        return [*layers, ("barred", "What bars it"), ("none", "Ground only")]

    @property
    def ramps(self) -> dict[str, list[str]]:
        """Colours of the 255 codes of the grids that are shown in colours: of C_r those of QGIS and of pictures."""
        tables, shades = {}, np.array([[*bytes.fromhex(text[1:])] for text in RAMP], np.float64)
        for grid in self.grids:
            values = grid.low + grid.step * np.arange(STEPS + 1)
            high = min(values[-1], self.most.get(grid.key, np.inf))
            part = np.clip((values - grid.low) / (high - grid.low or 1.0), 0.0, 1.0) * (len(shades) - 1)
            colours = np.stack([np.interp(part, range(len(shades)), channel) for channel in shades.T], axis=-1)
            tables[grid.key] = _hex(RideScale.of(self.record).colours(np.exp(values)) if grid.key == "c_r" else colours)
        return tables

    @property
    def most(self) -> dict[str, float]:
        """Values from which on colours are the same, by the keys of grids: nothing beyond them can be crossed."""
        return {"p_fail": FAIL_SHARE, "slope": float(self.record["cost"]["slope_limit_deg"])}

    @property
    def ride(self) -> dict[str, Any]:
        """Parts of the legend of C_r: the end of its scale, stops of its colours, place, name and limit of each class.

        Each class takes a quarter of the legend, from 0 to 1. Without classes that C_r decides there are no limits.
        """
        scale, limits = RideScale.of(self.record), class_limits(self.record)
        c_r = [0.0, *(value for pair in zip(scale.anchors, [*limits, scale.end], strict=True) for value in pair)]
        stops = list(zip(np.linspace(0.0, 1.0, len(c_r)).tolist(), _hex(scale.colours(np.array(c_r))), strict=True))
        texts = ["", *(f"{limit:.3g}" for limit in limits)]
        classes = [(at / 4, name, text) for at, (name, text) in enumerate(zip(CLASS_NAMES, texts, strict=True))]
        return {"end": f"{scale.end:.2g}", "stops": stops, "classes": classes if class_ranges(self.record) else []}

    @property
    def overlays(self) -> list[tuple[str, str, bool]]:
        """Keys and names of what is drawn over the colours, and whether it is at first."""
        below = [("photo", "Photo", True)] if self.photo else []
        overlays = [*below, ("relief", "Relief", not below), ("barred", "Closed ground in grey", True)]
        overlays += [("objects", "Obstacles", True)] if self.objects_known else []
        overlays += [("ways", "Way", True)] if self.ways else []
        return [*overlays, ("stretches", "Real drives", True)] if self.stretches else overlays

    def map_record(self) -> dict[str, Any]:
        """Return what the script of the page needs, as plain JSON."""
        return {
            "name": self.name,
            **self.tiles.spot.record(),
            "ground": packed(self.tiles.ground),
            "barred": packed(self.tiles.barred),
            "islands": packed(self.tiles.islands.astype(np.uint8)) if self.tiles.islands.any() else None,
            "grids": [grid.record() for grid in self.grids],
            "ramps": self.ramps,
            "objects": {"rows": self.objects.shape[0], "cols": self.objects.shape[1], "codes": self.packed_objects},
            "relief": self.relief,
            "photo": self.photo,
            "stretches": list(self.stretches),
            "ways": [
                {
                    "name": way.letter,
                    "lines": [line.tolist() for line in way.lines],
                    "profile": profile_places(way.profile),
                }
                for way in self.ways
            ],
            "degrees": self.degrees,
        }


def _corners(wkt: str, spot: Spot) -> list[list[float]] | None:
    """Return the corners of a map in degrees, see `Site.degrees`."""
    west, north = spot.west, spot.north
    east, south = west + spot.cols * spot.tile_size, north - spot.rows * spot.tile_size
    try:
        place = Transformer.from_crs(stated_crs(wkt).to_2d(), "OGC:CRS84", always_xy=True)
        eastings, northings = (np.array(each) / spot.unit for each in ((west, east) * 2, (north,) * 2 + (south,) * 2))
        found = np.column_stack(place.transform(eastings, northings))
    except ProjError:
        return None
    return [[round(value, 7) for value in corner] for corner in found.tolist()] if np.isfinite(found).all() else None


def _hex(colours: NDArray[np.float64]) -> list[str]:
    return [f"#{colour.tobytes().hex()}" for colour in np.rint(colours).astype(np.uint8)]


def _still(tiles: PageTiles, scale: RideScale, light: NDArray[np.uint8]) -> str:
    """Return the ride cost in the ``light`` of the photo or the relief as one picture, as the script draws it at first.

    Nothing is drawn where there are no points.
    """
    shown = tiles.spot.shown(_STILL_SIDE)
    shape, islands = (len(shown[0]), shown[1].shape[1]), tiles.islands
    colours = scale.colours(tiles.c_r)
    colours[islands] = on_islands(colours[islands])
    unknown = (tiles.ground >= UNKNOWN_FROM) | (tiles.barred == Barred.LITTLE_SEEN)
    closed = (tiles.barred != Barred.NO) & ~unknown
    colours[closed], colours[unknown] = CLOSED_COLOUR[:3], UNKNOWN_COLOUR[:3]
    above = np.asarray(Image.fromarray(light).resize(shape[::-1], Image.Resampling.BOX), np.float32)
    if above.ndim == 2:
        above = above[..., None]
    else:
        above = np.where((closed | unknown | islands)[shown][..., None], grey_of(above), above)
    picture = np.where(tiles.ground[shown][..., None] == NO_POINTS, _BLANK, hard_light(colours[shown], above))
    return jpeg(np.rint(picture).astype(np.uint8), 150_000)
