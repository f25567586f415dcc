"""Write all files of a map to its folder, the manifest last.

A raster has one pixel per tile (roughness, class, speed), or several (heightmap, obstacle, passage). relief.tif holds
the heights of the ground without holes, for looking at.
"""

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    BANDS,
    BARRED_TEXT,
    CLASS_NAMES,
    CROSSING_UNKNOWN,
    FREE,
    NO_CLASS,
    OBJECT_NAMES,
    REASON_TEXT,
    STEP_EDGE,
    UNSEEN,
    Band,
    Barred,
    CostTable,
    Georeference,
    Progress,
    Reason,
    SilentProgress,
    describe_crs,
    photo_column,
    vertical_of,
    write_together,
)
from bumpymap.layers._cog import TILE_WINDOW, write_cog
from bumpymap.layers.colours import (
    BARRED_COLOURS,
    CLASS_COLOURS,
    OBJECT_COLOURS,
    REASON_COLOURS,
    STEP_LINE,
    UNKNOWN_OBJECT,
    class_limits,
)
from bumpymap.layers.manifest import (
    MANIFEST_NAME,
    MapSummary,
    complete_manifest,
    describe_file,
    software_versions,
    summarise,
    write_manifest,
)
from bumpymap.layers.orthophoto import tiles_of_photo
from bumpymap.layers.placement import Placement, RasterSpec, RasterWindow
from bumpymap.layers.products import EVERY_FILE, MapFile
from bumpymap.layers.stac import write_item
from bumpymap.layers.tile_table import write_tiles
from bumpymap.layers.vector import GeoJsonCoordinates, dissolve, flatgeobuf_writer, geojson_writer
from bumpytiles import BLOCK_TILES, TileTable, TileWindow


def layer_metadata(manifest: Mapping[str, Any], place: Georeference) -> dict[str, Any]:
    """Return the entries that layers carry as metadata, as texts and lists of numbers; what is not known is left out.

    ``manifest``: the run's own entries for run.json, see `complete_manifest`; ``place``: CRS of the survey.
    """
    survey, calibration, settings = (manifest[name] for name in ("survey", "calibration", "settings"))
    is_papers, dates = settings.get("compat") == "paper", survey["dates"]
    vertical = None if place.crs is None else vertical_of(place.crs)
    heights = "none given; heights as in the survey, in metres"
    entries = {
        "survey": survey["name"],
        "survey_checksum": survey["checksum"],
        "survey_header_dates": "/".join(dates) if dates else None,  # first and last
        "vehicle": calibration["vehicle"],
        "calibration": calibration["id"],
        # Without it the speed is that of the vehicle's profile.
        "speed_m_per_s": settings.get("speed"),
        "p_fail_speed_m_per_s": manifest["vehicle"].get("drives_mps") if settings.get("speed") else None,
        "texture_model": manifest["model"],
        "rating": "paper" if is_papers else settings.get("rating"),
        # The paper's classes follow from its table of textures and z ranges.
        "class_limits_rad_per_m": None if is_papers else class_limits(manifest),
        "bumpymap_version": software_versions().get("bumpymap"),
        "vertical_crs": heights if vertical is None else f"{describe_crs(vertical)}; heights in metres",
    }
    return {name: value for name, value in entries.items() if value is not None}


_log = logging.getLogger(__name__)


def write_products(
    table: CostTable,
    folder: Path,
    *,
    local: bool,
    manifest: Mapping[str, Any],
    views: Callable[[Path, Mapping[str, Any], Callable[..., None]], None],
    progress: Progress | None = None,
) -> tuple[list[Path], MapSummary]:
    """Write all files of a run, or none; run.json is written last, so a folder that has one is complete.

    Files of an earlier run stay until all new ones are complete. Except for run.json, no file depends on the time, on
    the order of the tiles or on the output folder: the same map of the same survey has the same bytes.

    ``folder``: an existing folder, see `check_folder`; ``local``: write cost.geojson in the survey's own coordinates if
    it has no CRS; ``manifest``: the run's own entries for run.json, see `complete_manifest`; ``views``: writes the
    files of ``EVERY_VIEW_NAME``, given the folder, the content of run.json, and what waits for the layers of some
    names, or for all, since they are still being written; ``progress``: counts the layers as they are written. Returns
    the files, in the order of ``EVERY_FILE``; counts and medians of the map. Raises OutputError: a file cannot be
    written; BadInputError: the extent is too large for a raster, or there is no CRS and ``local`` is False.
    """
    started = time.perf_counter()
    placement = Placement.of(table)
    # Fail early: there may be no transformation from the survey's CRS to longitude and latitude.
    coordinates = GeoJsonCoordinates.of(placement, local=local)
    metadata = layer_metadata(manifest, table.georeference)
    progress = progress or SilentProgress()
    with write_together(folder, MANIFEST_NAME, EVERY_FILE) as staged:
        for layer in MapFile:
            (staged / layer).parent.mkdir(exist_ok=True)
        with _written(_layers(table, coordinates, staged, metadata), staged, progress) as written:
            summary = summarise(table, class_limits(manifest))
            record = complete_manifest(manifest, table, summary)

            def wait(*names: str) -> None:
                for name in names or written:
                    if name in written:
                        written[name].result()

            views(staged, record, wait)
            files = {file["path"]: file for future in written.values() for file in future.result()}
        record["files"] = [files[name] for name in EVERY_FILE if name in files]
        write_item(staged, record, placement)
        record["seconds"] = {**manifest["seconds"], "write": round(time.perf_counter() - started, 3)}
        record["files"].append(describe_file(staged / MapFile.ITEM) | {"path": MapFile.ITEM})
        write_manifest(record, staged / MANIFEST_NAME)
    _log.info("wrote %d tiles to %s", summary.tiles, folder)
    return [path for path in (folder / name for name in EVERY_FILE) if path.exists()], summary


_Layers: TypeAlias = dict[tuple[str, ...], Callable[[], None]]
_SIDE_BY_SIDE = 3
"""Layers that are written at a time: rasters take turns where GDAL writes them, see `raster_lock`, and save time where
it does not."""


def _layers(table: CostTable, coordinates: GeoJsonCoordinates, folder: Path, metadata: Mapping[str, Any]) -> _Layers:
    """Return functions that write layers, keyed by file names, in the order in which they begin.

    What the page shows and what takes longest comes first.
    """
    # Formats that hold nothing but texts have the numbers of a list with spaces between them.
    tags = {name: " ".join(map(str, own)) if isinstance(own, list) else str(own) for name, own in metadata.items()}

    def rasters(*names: MapFile) -> _Layers:
        return {(name,): partial(write_raster, name, table, folder / name, tags) for name in names}

    def write_regions() -> None:
        flat = folder / MapFile.REGIONS_IN_CRS
        with (
            geojson_writer(folder / MapFile.REGIONS, coordinates, metadata) as write_geojson,
            flatgeobuf_writer(flat, coordinates.placement, tags) as write_flatgeobuf,
        ):
            for regions in dissolve(table):
                write_geojson(regions)
                write_flatgeobuf(regions)

    photo = (MapFile.PHOTO,) if shows_photo(table) else ()
    return {
        **rasters(MapFile.HEIGHTMAP, MapFile.CLASS),
        (MapFile.TILES,): partial(write_tiles, table, folder / MapFile.TILES, tags),
        **rasters(*photo, MapFile.OBSTACLE, MapFile.ROUGHNESS),
        (MapFile.REGIONS, MapFile.REGIONS_IN_CRS): write_regions,
        **rasters(MapFile.PASSAGE, MapFile.REASON, MapFile.RELIEF, MapFile.COST, MapFile.SPEED, MapFile.BARRED),
    }


@contextmanager
def _written(layers: _Layers, folder: Path, progress: Progress) -> Iterator[dict[str, "Future[list[dict[str, Any]]]"]]:
    """Write layers side by side; after an error, and at the end of the body, no more begin.

    Yields by file name what will hold path, size and checksum of the files of its layer.
    """

    def write(names: Sequence[str], layer: Callable[[], None]) -> list[dict[str, Any]]:
        layer()
        files = [describe_file(folder / name) | {"path": name} for name in names]
        progress.advance(1)
        return files

    progress.start("writing layers", len(layers))
    with ThreadPoolExecutor(_SIDE_BY_SIDE) as pool:
        try:
            futures = {names: pool.submit(write, names, layer) for names, layer in layers.items()}
            yield {name: future for names, future in futures.items() for name in names}
        finally:
            pool.shutdown(cancel_futures=True)


_Number = TypeVar("_Number", np.int64, np.float64)


def box_sum(values: NDArray[_Number], half: int) -> NDArray[_Number]:
    """Return the sum in the square of ``2 * half + 1`` pixels around each pixel, (rows, cols) as ``values``."""
    side = 2 * half + 1
    for _ in range(2):  # down, then across
        total = np.cumsum(np.pad(values, ((half + 1, half), (0, 0))), axis=0)
        values = (total[side:] - total[:-side]).T
    return values


_PIXELS = 3
"""Pixels of relief.tif along a side of a tile: chosen, 1 m."""
_GAPS = (1, 2, 4, 8)
"""Half widths of the boxes that a pixel without heights is filled from, pixels: chosen, up to 8 m."""
_MARGIN = -(-_GAPS[-1] // _PIXELS)
"""Tiles around a window in which heights are needed for its pixels."""
_READ_TILES = 4096
"""Most tiles to read at a time: chosen, 4 MB of heights."""
_CENTIMETRE = 0.01
"""m: step of the heights of relief.tif."""


def _filled(
    tiles: TileTable, window: TileWindow, row: NDArray[np.int64], col: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Return the pixels of some tiles of a window, (n, 3, 3), m; NaN where no heights are near."""
    if not len(row):
        return np.empty((0, _PIXELS, _PIXELS), np.float32)
    wide = window.grown(_MARGIN)
    heights, known = _means(tiles, wide)
    values, left = np.where(known, heights, np.nan), ~known
    # Sums of whole numbers are exact, so a pixel has the same value in every window that it is in.
    for half in _GAPS:
        if not left.any():
            break
        count = box_sum(known.astype(np.int64), half)
        total = box_sum(heights, half)
        near = left & (count > 0)
        values[near] = np.rint(total[near] / count[near])
        left &= ~near
    metres = (values * _CENTIMETRE).astype(np.float32)
    by_tile = metres.reshape(wide.rows, _PIXELS, wide.cols, _PIXELS)
    return np.asarray(by_tile[wide.row + wide.rows - 1 - row, :, col - wide.col, :])


def _means(tiles: TileTable, window: TileWindow) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the mean height of each pixel of a window, north up, in whole cm, 0 without any, and where there are any.

    A pixel of the heightmap counts where its middle lies.
    """
    shape = (window.rows, _PIXELS, window.cols, _PIXELS)
    means, known = np.zeros(shape, np.int64), np.zeros(shape, np.bool_)
    fine = tiles.grid.pixels
    place = (2 * np.arange(fine) + 1) * _PIXELS // (2 * fine)
    for strip in tiles.strips(_READ_TILES, window):
        found = tiles.read(("heights",), strip)
        heights = found["heights"].astype(np.float64)
        counted = np.isfinite(heights)
        heights[~counted] = 0.0
        line, column = window.cells(found["col"], found["row"])
        for down in range(_PIXELS):
            for right in range(_PIXELS):
                rows, cols = (slice(*np.searchsorted(place, (at, at + 1)).tolist()) for at in (down, right))
                count = counted[:, rows, cols].sum(axis=(1, 2))
                total = heights[:, rows, cols].copy().sum(axis=(1, 2))  # of one piece: sums in the order of the pixels
                some = count > 0
                where = line[some], down, column[some], right
                means[where] = np.rint(total[some] / count[some] / _CENTIMETRE)
                known[where] = True
    flat = (window.rows * _PIXELS, window.cols * _PIXELS)
    return means.reshape(flat), known.reshape(flat)


HEIGHT_BLOCK = 512
"""Side of a block of rasters with several pixels a tile, pixels."""
_WINDOW_PIXELS = 1024
"""Side of a window of such a raster, pixels; rounded down to whole blocks of tiles, at least one."""
_SPARSE = 0.1
"""Below this share of tiles with points in its extent a survey is sparse: then it may have no photo."""
_MOST_OF_SPARSE = 100_000_000
"""Most pixels of the photo of a sparse survey: 10^9, nearly all empty, take 26 s of CPU time."""
_Found: TypeAlias = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class _Layer:
    """A raster of a map."""

    title: str
    bands: Sequence[Band]
    columns: tuple[str, ...]
    """Columns of the tiles that ``values`` needs, or that are the values."""
    values: Callable[[_Found, RasterWindow], Sequence[NDArray[Any]] | NDArray[Any]] | None = None
    """Returns the values of n tiles, given their columns and the window that they are all of: an array (n,), or (n,
    pixels, pixels), for each band. None: the columns as they are."""
    has_heights: bool = False
    """True if its CRS has the vertical part."""
    tags: Mapping[str, str] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    """Fields of its `RasterSpec`."""


def _rasters(table: CostTable) -> dict[MapFile, _Layer]:
    """Return the rasters of a map."""
    rule, names = table.rule, tuple(band.name for band in BANDS)
    pixels: dict[str, Any] = {"pixels": table.tiles.grid.pixels, "block": HEIGHT_BLOCK}
    # On 56 million pixels of heightmap.tif, level 6 took twice the time of level 1 and saved 4 % of the bytes.
    pixels["level"] = 1
    codes: dict[str, Any] = {"dtype": "uint8", "nodata": NO_CLASS, "overviews": "MODE"}

    def of_codes(title: str, column: str, band: Band, colours: Mapping[int, tuple[int, int, int, int]]) -> _Layer:
        options = codes | {"colours": dict(colours), "counts_nodata": True}
        return _Layer(title, [band], (column,), options=options)

    def costs(found: _Found, _: RasterWindow) -> list[NDArray[np.float64]]:
        cost = rule.cost(found["c_r"].astype(np.float64), rule.hazard(found["p_fail"]))
        return [np.where(found["barred"] == 0, cost, np.nan)]

    def speeds(found: _Found, _: RasterWindow) -> list[NDArray[np.float64]]:
        known = ~np.isin(found["barred"], CROSSING_UNKNOWN) & np.isfinite(found["c_r"])
        speed = 1.0 / rule.slowness(found["c_r"])
        return [np.where(known, np.where(found["barred"] == Barred.NO, speed, 0.0), np.nan)]

    def objects(found: _Found, _: RasterWindow) -> list[NDArray[np.uint8]]:
        state = found["objects"]
        hidden = (state == UNSEEN) | ((state == FREE) & np.isnan(found["obstacle"])[:, None, None])
        return [np.select([hidden, state == STEP_EDGE], [np.uint8(UNKNOWN_OBJECT), np.uint8(STEP_LINE)], state)]

    def roughness(found: _Found, _: RasterWindow) -> list[NDArray[Any]]:
        zone = np.where(found["zone"] > 0, found["zone"], np.nan)
        return [zone if name == "zone" else found[name] for name in names]

    def photo(found: _Found, window: RasterWindow) -> NDArray[np.uint8]:
        colours = found["photo"] if table.orthophoto is None else tiles_of_photo(table, window, found)
        return np.moveaxis(_with_alpha(colours), -1, 0)

    reasons = {int(code): colour for code, colour in REASON_COLOURS.items() if code != Reason.NO_POINTS}
    reasons[NO_CLASS] = REASON_COLOURS[Reason.NO_POINTS]
    return {
        MapFile.ROUGHNESS: _Layer("ride cost and roughness of each tile", BANDS, names, roughness),
        MapFile.CLASS: of_codes(
            "roughness class of each tile",
            "class_id",
            Band("class", "", "0 (flattest) to 3 (roughest)", CLASS_NAMES),
            CLASS_COLOURS,
        ),
        MapFile.REASON: of_codes(
            "why tiles have no class",
            "reason",
            Band("reason", "", "why a tile has no class", tuple(REASON_TEXT.values())),
            reasons,
        ),
        MapFile.COST: _Layer(
            "cost of driving over each tile",
            [Band("cost", "", "factor on distance: 1 + ride_weight c_r + fail_weight hazard")],
            ("c_r", "p_fail", "barred"),
            costs,
            tags={
                "fail_weight_m": f"{rule.fail_weight:g}",
                "drive_m": f"{rule.drive_m:g}",
                "slope_limit_deg": f"{rule.slope_limit_deg:g}",
            },
        ),
        MapFile.SPEED: _Layer(
            "speed made good: the highest at which the ride stays within the comfort limits of the vehicle profile",
            [Band("speed", "m/s", "highest within the comfort limits, 0 where not passable; soil is not in it")],
            ("c_r", "barred"),
            speeds,
            tags={
                "top_speed_m_per_s": f"{rule.top_mps:g}",
                "m_per_s_up_to_c_r_rad_per_m": ", ".join(f"{speed:g} up to {c_r:g}" for c_r, speed in rule.speeds),
                "not_in_it": "soil, grip, slope, turns",
            },
            options={"overviews": "NEAREST"},  # a mean with the 0 of barred tiles would look like slow ground
        ),
        MapFile.BARRED: of_codes(
            "why tiles are not passable",
            "barred",
            Band("barred", "", "why the tile is not passable", tuple(BARRED_TEXT.values())),
            BARRED_COLOURS,
        ),
        MapFile.HEIGHTMAP: _Layer(
            "height map",
            [Band("height", "m", "mean height of the points in the pixel")],
            ("heights",),
            has_heights=True,
            options=pixels,
        ),
        MapFile.RELIEF: _Layer(
            "relief for looking at: holes are filled; measure on heightmap.tif",
            [Band("height", "m", "mean height, holes filled from around them; measure on heightmap.tif")],
            (),
            lambda found, window: [_filled(table.tiles, window.tiles, found["row"], found["col"])],
            has_heights=True,
            options={"pixels": _PIXELS, "block": HEIGHT_BLOCK},
        ),
        MapFile.OBSTACLE: _Layer(
            "obstacles",
            [Band("obstacle", "", "obstacles on the ground, canopy over it, steps of it", OBJECT_NAMES)],
            ("objects", "obstacle"),
            objects,
            options=codes | pixels | {"colours": OBJECT_COLOURS},
        ),
        MapFile.PHOTO: _Layer(
            "colours of the points" if table.orthophoto is None else "orthophoto",
            [*(Band(name) for name in ("red", "green", "blue")), Band("alpha")],
            (photo_column(table.tiles.grid.pixels).name,) if table.orthophoto is None else (),
            photo,
            options=pixels | {"dtype": "uint8", "nodata": 0, "is_photo": True},
        ),
        MapFile.PASSAGE: _Layer(
            "where the vehicle fits",
            [Band("passage", "", "areas of a tile in which the middle of the vehicle can move; 0 where it cannot be")],
            ("passage",),
            options=codes | pixels,
        ),
    }


def shows_photo(table: CostTable) -> bool:
    """Return whether a map has a photo: enough points have a colour, and its pixels are not nearly all empty."""
    tiles = table.tiles
    extent = tiles.window.cols * tiles.window.rows
    if table.orthophoto is not None:
        return True
    return table.has_photo and (tiles.tiles >= _SPARSE * extent or extent * tiles.grid.pixels**2 <= _MOST_OF_SPARSE)


def _with_alpha(photo: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return red, green, blue and alpha of the colours of tiles, (n, pixels, pixels, 3), of which 0, 0, 0 is none.

    Such pixels have alpha 0 and the mean colour of their tile: JPEG mixes what is hidden into what lies beside it.
    """
    tiles, side = photo.shape[:2]
    known = (photo[..., 0] | photo[..., 1] | photo[..., 2]) > 0
    # Whole numbers, so that sums are exact; a product of matrices takes a third of the time of a sum of bytes.
    total = np.ones(side * side, np.float32) @ photo.reshape(tiles, side * side, 3).astype(np.float32)
    mean = (total // np.maximum(known.sum(axis=(1, 2)), 1)[:, None]).astype(np.uint8)
    out = np.empty((*known.shape, 4), np.uint8)
    for band in range(3):
        out[..., band] = np.where(known, photo[..., band], mean[:, band, None, None])
    out[..., 3] = known * np.uint8(255)
    return out


def write_raster(file: MapFile, table: CostTable, path: Path, about: Mapping[str, str] | None = None) -> None:
    """Write a raster of a map as a COG; what each holds is said in `_rasters` and on the page about files.

    A pixel of relief.tif without heights has the mean of those with heights that are at most 1 pixel away along both
    axes, else at most 2, 4 or 8; NaN if there are none. In passage.tif 0 is closed, since an obstacle, unseen ground or
    a tile that the ground bars is nearer than half the vehicle's width and its margin; from 1 on, codes are the areas
    of a tile whose pixels are connected, the largest first; those of two tiles are joined where their pixels touch.

    ``about``: metadata of the file, such as vehicle and calibration. Raises OutputError: the file cannot be written;
    BadInputError: the extent is too large for a raster.
    """
    place, tiles, layer = Placement.of(table), table.tiles, _rasters(table)[file]
    tags = {"title": layer.title, "tile_size_m": f"{tiles.grid.tile_size:g}"}
    tags |= {"ride_weight_m_per_rad": f"{table.rule.ride_weight:g}", **layer.tags, **(about or {})}
    crs = place.height_crs if layer.has_heights else place.horizontal_crs
    spec = RasterSpec(bands=layer.bands, crs=crs, tags=tags, **layer.options)
    pixels = spec.pixels

    def paint(window: RasterWindow) -> NDArray[np.generic] | None:
        if not tiles.holds(window.tiles):
            return None
        found = tiles.read(layer.columns, window.tiles)
        values = [found[name] for name in layer.columns] if layer.values is None else layer.values(found, window)
        line, column = window.tiles.cells(found["col"], found["row"])
        lines, columns = window.tiles.rows, window.tiles.cols
        canvas = np.full((len(spec.bands), lines, pixels, columns, pixels), spec.nodata, spec.dtype)
        for band, value in zip(canvas, values, strict=True):
            band[line, :, column, :] = value.reshape(-1, pixels, pixels)
        return canvas.reshape(len(spec.bands), lines * pixels, columns * pixels)

    side = max(1, _WINDOW_PIXELS // (BLOCK_TILES * pixels)) * BLOCK_TILES if pixels > 1 else TILE_WINDOW
    write_cog(path, place, spec, paint, side)
