"""Write a map in sheets: each a complete folder of layers, then what leads to them, the manifest last."""

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import rasterio
import rasterio.shutil
from rasterio.errors import RasterioError

from bumpymap.core import (
    CLASS_NAMES,
    BadInputError,
    CostTable,
    OutputError,
    Progress,
    SilentProgress,
    UsageError,
    atomic,
    read_record,
    utf8_path,
    write_csv,
    write_together,
)
from bumpymap.layers.colours import class_limits
from bumpymap.layers.folder import ViewWriter, verified_record, write_products
from bumpymap.layers.manifest import (
    MANIFEST_NAME,
    SHEETS_FORMAT,
    complete_manifest,
    describe_file,
    write_manifest,
)
from bumpymap.layers.map_files import open_layer
from bumpymap.layers.placement import MAX_PIXELS, MAX_SIDE, MAX_TILES, Placement
from bumpymap.layers.products import (
    CATALOG_NAME,
    EVERY_NAME,
    EVERY_VIEW_NAME,
    SHEET_FOLDER,
    SHEET_TABLE_NAME,
    SPEEDS_NAME,
    SPEEDS_VIRTUAL_NAME,
    VIRTUAL_NAMES,
)
from bumpymap.layers.sheet_paths import (
    MAP_FILES,
    SPEEDS_FILES,
    make_sheet_folder,
    remove_files,
    remove_sheets,
    sheet_folders,
)
from bumpymap.layers.stac import write_catalog
from bumpymap.layers.summary import STRIP, MapSummary, summarise
from bumpymap.layers.vector import GeoJsonCoordinates
from bumpytiles import BLOCK_TILES, Grid, TileTable, TileWindow

__all__ = [
    "SheetLayout",
    "SheetRun",
    "made_names",
    "require_whole",
    "suggested_sheets",
    "write_sheets",
    "write_virtual",
]

MAX_SHEETS = 10_000
"""Most sheets in the bounding window of a survey: a virtual raster lists every sheet in each of its bands."""
_FARTHEST = 20_000_000.0
"""m: no coordinate of a projected CRS is larger, so names of sheets have as many digits as this needs."""
_LEAST_DIGITS = 4

SheetPlace = tuple[int, int]
"""Column and row of a sheet; rows grow to the north, and the CRS origin is the south-west corner of sheet (0, 0)."""


def suggested_sheets(grid: Grid) -> float:
    """Return a usual side of sheets, km: 5, less where tiles or pixels are small, more where a block is larger."""
    most = _most_blocks(grid) * BLOCK_TILES * grid.tile_size / 1000.0
    digit = 10.0 ** math.floor(math.log10(most))
    return max(min(5.0, math.floor(most / digit) * digit), BLOCK_TILES * grid.tile_size / 1000.0)


def _most_blocks(grid: Grid) -> int:
    return min(MAX_SIDE, math.isqrt(MAX_TILES), math.isqrt(MAX_PIXELS) // grid.pixels) // BLOCK_TILES


@dataclass(frozen=True, slots=True)
class SheetLayout:
    """The squares that a map is cut into."""

    grid: Grid
    side: int
    """Tiles along a side, a multiple of a block's."""

    @classmethod
    def of(cls, grid: Grid, kilometres: float) -> "SheetLayout":
        """Return sheets of about this size: rounded to whole blocks, at least one.

        Raises
        ------
        UsageError
            Sheets are smaller than a block, or larger than the largest map.
        """
        block, most = BLOCK_TILES * grid.tile_size / 1000.0, _most_blocks(grid)
        blocks = round(kilometres / block)
        if not 1 <= blocks <= most:
            raise UsageError(
                f"`sheets` is {kilometres:g} km; with tiles of {grid.tile_size:g} m and {grid.pixels} pixels a sheet "
                f"has a side of at least {block:g} km (one block of {BLOCK_TILES} x {BLOCK_TILES} tiles) and at most "
                f"{most * block:g} km, the largest map. Give `sheets={suggested_sheets(grid):g}` or another number "
                "between them"
            )
        return cls(grid, blocks * BLOCK_TILES)

    @property
    def kilometres(self) -> float:
        """Side of a sheet, km."""
        return self.side * self.grid.tile_size / 1000.0

    def count(self, window: TileWindow) -> tuple[int, int]:
        """Return the columns and rows of sheets that a window of tiles overlaps."""
        spans = ((window.col, window.cols), (window.row, window.rows))
        cols, rows = ((start + length - 1) // self.side - start // self.side + 1 for start, length in spans)
        return cols, rows

    def check_whole(self, window: TileWindow) -> None:
        """Raise BadInputError if a survey with these tiles would have too many sheets."""
        cols, rows = self.count(window)
        if cols * rows <= MAX_SHEETS:
            return
        width, height = (side * self.grid.tile_size / 1000 for side in (window.cols, window.rows))
        needed = self.kilometres * math.sqrt(cols * rows / MAX_SHEETS) * 1.1
        raise BadInputError(
            f"the survey spans {width:,.1f} km x {height:,.1f} km: {cols:,} x {rows:,} sheets of "
            f"{self.kilometres:g} km, and there may be {MAX_SHEETS:,}. Give larger ones, such as "
            f"`sheets={math.ceil(needed)}`; if the survey is smaller, look for points far outside it"
        )

    def places(self, tiles: TileTable) -> list[SheetPlace]:
        """Return the sheets that hold tiles, west column first, then south row first."""
        keys = np.array(tiles.keys, np.int64) // (self.side // BLOCK_TILES)
        return [(col, row) for col, row in np.unique(keys[:, ::-1], axis=0).tolist()]

    def window(self, place: SheetPlace) -> TileWindow:
        """Return the tiles of a sheet."""
        return TileWindow(place[0] * self.side, place[1] * self.side, self.side, self.side)

    def name(self, place: SheetPlace) -> str:
        """Return the name of a sheet's folder, such as ``e0102_n0842``: its column and row; west and south below 0.

        Sheets of one size have names of one length.
        """
        digits = max(_LEAST_DIGITS, len(str(math.ceil(_FARTHEST / (self.side * self.grid.tile_size)))))
        (col, row), letters = place, ("we"[place[0] >= 0], "sn"[place[1] >= 0])
        return f"{letters[0]}{abs(col):0{digits}d}_{letters[1]}{abs(row):0{digits}d}"


_FAILURES: tuple[type[Exception], ...] = (RasterioError, rasterio._err.CPLE_BaseError)  # noqa: SLF001 (no public name)
_OF_ONE_SHEET = "STATISTICS_"
"""Metadata of this name do not hold for all sheets."""


@dataclass(frozen=True, slots=True)
class _Source:
    """A raster of a sheet."""

    path: str
    width: int
    height: int
    block: tuple[int, int]
    """Rows and columns."""
    left: int
    """Place in the virtual raster, pixels."""
    top: int


def write_virtual(path: Path, root: Path, placement: Placement, sheets: Mapping[str, TileWindow]) -> None:
    """Write a virtual raster; the same sheets give the same bytes.

    Parameters
    ----------
    path : Path
        The file to write, ``NAME.vrt`` for the rasters ``NAME.tif``.
    root : Path
        The folder that it will be moved to: paths in it are relative to this one.
    placement : Placement
        The extent of all sheets.
    sheets : mapping
        Path, relative to ``root``, of the folder of each sheet, and the tiles that its rasters span.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        The raster of a sheet cannot be read.
    """
    raster = f"{path.stem}.tif"
    try:
        sources = [_source(root, f"{folder}/{raster}", placement.window, window) for folder, window in sheets.items()]
        tree = _template(path, root / sources[0].path)
    except _FAILURES as error:
        raise BadInputError(f"cannot read {raster} of a sheet in {root}: {error}. Map the survey again") from error
    pixels = sources[0].width // next(iter(sheets.values())).cols
    window = placement.window
    tree.set("rasterXSize", str(window.cols * pixels))
    tree.set("rasterYSize", str(window.rows * pixels))
    place = tree.find("GeoTransform")
    if place is not None:
        place.text = ", ".join(f"{number:.17g}" for number in placement.transform(pixels).to_gdal())
    for domain in tree.findall("Metadata[@domain]"):
        tree.remove(domain)
    for band in tree.iter("VRTRasterBand"):
        _fill_band(band, sources)
    ET.indent(tree)
    with atomic(path) as temporary:
        temporary.write_bytes(ET.tostring(tree, encoding="utf-8") + b"\n")


def _source(root: Path, path: str, whole: TileWindow, window: TileWindow) -> _Source:
    with open_layer(root / path) as file:
        pixels = file.width // window.cols
        left = (window.col - whole.col) * pixels
        top = (whole.row + whole.rows - window.row - window.rows) * pixels
        return _Source(path, file.width, file.height, file.block_shapes[0], left, top)


def _template(path: Path, raster: Path) -> ET.Element:
    """Return the VRT that GDAL makes of one raster."""
    scratch = path.with_name(f".{path.stem}.one.vrt")
    try:
        rasterio.shutil.copy(str(raster), str(scratch), driver="VRT")
        return ET.parse(scratch).getroot()  # noqa: S314 (GDAL has just written it)
    finally:
        scratch.unlink(missing_ok=True)


def _fill_band(band: ET.Element, sources: Sequence[_Source]) -> None:
    """Replace the sources of a band, and remove what is true of one sheet only."""
    for one in band.findall("SimpleSource") + band.findall("ComplexSource"):
        band.remove(one)
    for table in band.findall("GDALRasterAttributeTable"):
        band.remove(table)  # its counts are those of one sheet
    for metadata in band.findall("Metadata"):
        for entry in [entry for entry in metadata if entry.get("key", "").startswith(_OF_ONE_SHEET)]:
            metadata.remove(entry)
    number, kind = band.get("band", "1"), band.get("dataType", "")
    names, colours = band.find("CategoryNames"), band.find("ColorTable")
    if names is not None and colours is not None:
        for unused in colours[len(names) :]:  # a list of classes then shows those that exist
            colours.remove(unused)
    for source in sources:
        element = ET.SubElement(band, "SimpleSource")
        ET.SubElement(element, "SourceFilename", {"relativeToVRT": "1"}).text = source.path
        ET.SubElement(element, "SourceBand").text = number
        block = {"BlockXSize": str(source.block[1]), "BlockYSize": str(source.block[0])}
        raster = {"RasterXSize": str(source.width), "RasterYSize": str(source.height), "DataType": kind}
        ET.SubElement(element, "SourceProperties", raster | block)
        _add_box(element, "SrcRect", 0, 0, (source.width, source.height))
        _add_box(element, "DstRect", source.left, source.top, (source.width, source.height))


def _add_box(element: ET.Element, name: str, left: int, top: int, size: tuple[int, int]) -> None:
    sides = {"xOff": left, "yOff": top, "xSize": size[0], "ySize": size[1]}
    ET.SubElement(element, name, {side: str(value) for side, value in sides.items()})


def made_names(record: dict[str, Any] | None) -> tuple[str, ...]:
    """Return the names of the files that a map with this manifest has beside it, which it lists with checksums."""
    in_sheets = (record or {}).get("format") == SHEETS_FORMAT
    return (*virtual_names(record or {}), SHEET_TABLE_NAME) if in_sheets else _layers(record or {})


def virtual_names(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the virtual rasters over the sheets of a map with this manifest, or its entries."""
    return (*VIRTUAL_NAMES, SPEEDS_VIRTUAL_NAME) if _has_speeds(record) else VIRTUAL_NAMES


def _layers(record: Mapping[str, Any]) -> tuple[str, ...]:
    without = {MANIFEST_NAME} if _has_speeds(record) else {MANIFEST_NAME, SPEEDS_NAME}
    return tuple(name for name in EVERY_NAME if name not in without)


def _has_speeds(record: Mapping[str, Any]) -> bool:
    settings = record.get("settings")
    return bool(settings.get("speeds")) if isinstance(settings, Mapping) else False


def is_finished(sheet: Path, place: dict[str, Any]) -> bool:
    """Return whether a folder holds the complete sheet of this place and run, every file as it was written."""
    record = read_record(sheet / MANIFEST_NAME) or {}
    if record.get("sheet") != place:
        return False
    try:
        with verified_record(sheet, _layers(record)):
            return True
    except OutputError:
        return False


def require_whole(folder: Path, record: dict[str, Any]) -> None:
    """Raise OutputError if a sheet of a complete map is missing or has changed; do nothing if it has no sheets."""
    if record.get("format") != SHEETS_FORMAT:
        return
    try:
        sheets = sheet_folders(folder)
        sums = [describe_file(sheet / MANIFEST_NAME)["sha256"] for sheet in sheets]
    except BadInputError as error:
        raise OutputError(f"{error}. Choose another `out`, or pass `overwrite=True` to replace it") from error
    for sheet, entry, found in zip(sheets, record["sheets"], sums, strict=True):
        if entry["sha256"] != found:
            raise OutputError(
                f"{folder} already holds a complete run, but {sheet / MANIFEST_NAME} has changed since. Choose another "
                "`out`, or pass `overwrite=True` to replace it"
            )
        with verified_record(sheet, _layers(record)):
            pass


_log = logging.getLogger(__name__)
_BOUNDS = ("min_x", "min_y", "max_x", "max_y")


@dataclass(frozen=True, slots=True)
class SheetRun:
    """How a run is written in sheets."""

    layout: SheetLayout
    key: str
    """Tells runs of other inputs, settings or versions apart."""
    keep: bool
    """True if sheets that an interrupted run with the same key has finished are kept."""
    manifest_of: Callable[[TileWindow], Mapping[str, Any]]
    """Returns the run's own entries for the run.json of a sheet with these tiles."""


def write_sheets(
    table: CostTable,
    folder: Path,
    run: SheetRun,
    *,
    local: bool,
    manifest: Mapping[str, Any],
    views: ViewWriter,
    progress: Progress | None = None,
) -> tuple[list[Path], MapSummary]:
    """Write the layers of a run in sheets; sheets without tiles are not made.

    The run.json of the whole map is written last, and that of an earlier one is removed first, so a folder that has
    one is complete. So is each sheet that has one. The layers are those of the same map without sheets, cut at the
    edges of sheets; a sheet spans the smallest window around its tiles.

    Parameters
    ----------
    table : CostTable
        The tiles, rated with their neighbours across the edges of sheets.
    folder : Path
        An existing folder, see `check_folder`.
    run : SheetRun
    local : bool
        See `write_products`.
    manifest : mapping
        The run's own entries for the run.json of the whole map, see `complete_manifest`.
    views : callable
        See `write_products`.
    progress : Progress, optional
        Counts the sheets as they are written.

    Returns
    -------
    list of Path
        The virtual rasters, the table of sheets, run.json, the catalogue, and the files of ``EVERY_VIEW_NAME`` for the
        whole map.
    MapSummary
        Counts and medians of the whole map.

    Raises
    ------
    OutputError
        A file cannot be written, or a link stands where a sheet belongs.
    BadInputError
        There is no CRS and ``local`` is False.
    """
    started = time.perf_counter()
    progress = progress or SilentProgress()
    whole = Placement(table.georeference, table.tiles.grid, table.tiles.window)
    GeoJsonCoordinates.of(whole, local=local)  # fails early, as in `write_products`
    places = dict(sorted((run.layout.name(place), place) for place in run.layout.places(table.tiles)))
    remove_files(folder, (MANIFEST_NAME,))  # from now on the folder holds no complete map
    progress.start("writing sheets", len(places))
    windows: dict[str, TileWindow] = {}
    for name, place in places.items():
        part = replace(table, tiles=table.tiles.part(run.layout.window(place)))
        windows[f"{SHEET_FOLDER}/{name}"] = part.tiles.window
        _write_sheet(part, make_sheet_folder(folder, name), place, run, views, around=table.tiles, local=local)
        progress.advance(1)
    summary = summarise(table, class_limits(manifest))
    remove_files(folder, (*MAP_FILES, *SPEEDS_FILES))
    remove_sheets(folder, keep=places)
    virtual = virtual_names(manifest)
    with write_together(folder, MANIFEST_NAME) as staged, utf8_path(folder) as root:
        for name in virtual:
            write_virtual(staged / name, root, whole, windows)
        sheets = [
            _describe(root, path, place, whole, windows[path])
            for path, place in zip(windows, places.values(), strict=True)
        ]
        _write_table(staged / SHEET_TABLE_NAME, sheets)
        files = [describe_file(staged / name) | {"path": name} for name in (*virtual, SHEET_TABLE_NAME)]
        record = complete_manifest(manifest, table, summary, files)
        record |= {
            "format": SHEETS_FORMAT,
            "sheet_side_m": run.layout.side * whole.grid.tile_size,
            "sheets": sheets,
        }
    with utf8_path(folder) as root:
        views(root, record)
        write_catalog(root, list(windows), title=str((record.get("survey") or {}).get("name") or "Map in sheets"))
        record["seconds"] = {**manifest.get("seconds", {}), "write": round(time.perf_counter() - started, 3)}
        write_manifest(record, root / MANIFEST_NAME)
    _log.info("wrote %d tiles in %d sheets to %s", summary.tiles, len(places), folder)
    shown = [name for name in EVERY_VIEW_NAME if (folder / name).is_file()]
    return [folder / name for name in (*virtual, SHEET_TABLE_NAME, MANIFEST_NAME, CATALOG_NAME, *shown)], summary


def _write_sheet(
    table: CostTable,
    sheet: Path,
    place: SheetPlace,
    run: SheetRun,
    views: ViewWriter,
    *,
    around: TileTable,
    local: bool,
) -> None:
    """Write one sheet, unless an interrupted run has finished it."""
    about = {"name": sheet.name, "column": place[0], "row": place[1], "side_tiles": run.layout.side, "run": run.key}
    if run.keep and is_finished(sheet, about):
        return
    points = sum(int(table.tiles.read(("count",), strip)["count"].sum()) for strip in table.tiles.strips(STRIP))
    own = {**run.manifest_of(table.tiles.window), "sheet": about, "points": points, "seconds": {}}
    write_products(table, sheet, local=local, manifest=own, views=views, around=around)


def _describe(root: Path, path: str, place: SheetPlace, whole: Placement, window: TileWindow) -> dict[str, Any]:
    """Return what the manifest of the map says of a sheet; ``root`` is the folder that ``path`` is relative to."""
    corners = np.array([window.col, window.row, window.col + window.cols, window.row + window.rows])
    record = read_record(root / path / MANIFEST_NAME) or {}
    counts = record["counts"]
    return {
        "folder": path,
        "column": place[0],
        "row": place[1],
        "bounds": whole.to_crs(corners).tolist(),
        "points": counts["points"],
        **{name: counts[name] for name in ("tiles", "classified", "unknown", "passable", "by_class")},
        "bytes": sum(file["bytes"] for file in record["files"]),
        "sha256": describe_file(root / path / MANIFEST_NAME)["sha256"],
    }


def _write_table(path: Path, sheets: Sequence[Mapping[str, Any]]) -> None:
    """Write sheets.csv, one row a sheet."""
    numbers = ("points", "tiles", *(name.replace(" ", "_") for name in CLASS_NAMES), "unknown", "passable", "bytes")
    rows = []
    for sheet in sheets:
        classes = {name.replace(" ", "_"): count for name, count in sheet["by_class"].items()}
        values = {**sheet, **classes}
        places = (f"{side:.10g}" for side in sheet["bounds"])
        rows.append((sheet["folder"], sheet["column"], sheet["row"], *places, *(values[name] for name in numbers)))
    write_csv(path, ("folder", "column", "row", *_BOUNDS, *numbers), rows, end="\n")
