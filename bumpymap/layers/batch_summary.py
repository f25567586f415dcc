"""summary.csv, summary.parquet and index.html: one row for each survey of a batch."""

import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from os.path import lexists
from pathlib import Path
from types import NoneType
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pyproj import Transformer
from pyproj.exceptions import ProjError

from bumpymap.core import (
    CLASS_NAMES,
    NO_CLASS,
    BadInputError,
    Barred,
    OutputError,
    escape_controls,
    open_regular,
    parse_json,
    shares_text,
    stated_crs,
    utf8_path,
    write_csv,
    write_remedy,
    write_together,
)
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS
from bumpymap.layers.manifest import read_manifest
from bumpymap.layers.map_files import RemoteFolder, open_raster
from bumpymap.layers.products import CATALOG_NAME
from bumpymap.layers.route.drawing import bar_length

__all__ = [
    "BATCH_LOG",
    "BATCH_NAMES",
    "SurveyRow",
    "SurveyStatus",
    "SurveyView",
    "check_batch_out",
    "index_page",
    "map_facts",
    "read_thumbnail",
    "write_batch_summary",
]


SurveyStatus: TypeAlias = Literal["done", "already done", "incomplete", "failed", "not reached"]
"""``incomplete``: layers were written, but files were skipped, or too many tiles are unknown."""


def _column(description: str, unit: str = "") -> Any:
    return field(default=None, metadata={"description": description} | ({"unit": unit} if unit else {}))


@dataclass(frozen=True, slots=True)
class SurveyRow:
    """What became of one survey. None: not known, as that of a survey without layers."""

    name: str
    """Folder of its layers."""
    status: SurveyStatus
    message: str = ""
    """Why it failed, or what is incomplete."""
    warnings: tuple[str, ...] = field(
        default=(), metadata={"description": "warnings of the run, in a table separated by ' | '"}
    )
    seconds: float | None = _column("wall time of the run that made the layers, or until it failed", "s")
    survey: str = ""
    """Its files or folder, as the run was given them; a URL without user and query, which may hold a key."""
    points: int | None = _column("points read that are neither withheld nor noise")
    density: float | None = _column("points per area of the tiles with points", "1/m2")
    area: float | None = _column("area of the tiles with points", "m2")
    tiles: int | None = _column("tiles with points")
    share_smooth: float | None = _column("share of the tiles of class 0")
    share_fair: float | None = _column("share of the tiles of class 1")
    share_rough: float | None = _column("share of the tiles of class 2")
    share_very_rough: float | None = _column("share of the tiles of class 3")
    share_passable: float | None = _column("share of the tiles that are passable")
    share_unknown: float | None = _column("share of the tiles without a class")
    unknown_reason: str | None = _column("why most of them have none")
    crs: str | None = _column("code of the CRS, or its name")
    min_x: float | None = _column("west edge of the tiles", "units of the CRS")
    min_y: float | None = _column("south edge of the tiles", "units of the CRS")
    max_x: float | None = _column("east edge of the tiles", "units of the CRS")
    max_y: float | None = _column("north edge of the tiles", "units of the CRS")
    vehicle: str | None = _column("vehicle of the calibration")
    calibration: str | None = _column("id of the calibration")
    checksum: str | None = _column("checksums of the input files, as in run.json, separated by spaces")


_LEAST_WIDTH, _WIDTH, _MOST_HEIGHT, _EDGE = 260.0, 640.0, 280.0, 24.0
_DEGREE_M = 111_320.0
_LEAST_M = 100.0
_SMALLEST_PX = 7.0


def _places(rows: Sequence[SurveyRow]) -> dict[str, Any] | None:
    """Return the map of the surveys in pixels; None if fewer than two have a known place, or they lie far apart."""
    found = [(row, box) for row in rows if (box := _box(row))]
    if len(found) < 2:
        return None
    lows, highs = (pick(np.array([box for _, box in found]), axis=0).tolist() for pick in (np.min, np.max))
    (west, south, _, _), (_, _, east, north) = lows, highs
    if east - west > 180 or max(abs(south), abs(north)) > 85:
        return None
    east_m = _DEGREE_M * math.cos(math.radians((south + north) / 2))
    wide, high = max((east - west) * east_m, _LEAST_M), max((north - south) * _DEGREE_M, _LEAST_M)
    scale = min((_WIDTH - 2 * _EDGE) / wide, (_MOST_HEIGHT - 2 * _EDGE) / high)
    boxes = []
    for row, (left, bottom, right, top) in found:
        size = (right - left) * east_m * scale, (top - bottom) * _DEGREE_M * scale
        grown = [max(side, _SMALLEST_PX) for side in size]
        x, y = _EDGE + (left - west) * east_m * scale, _EDGE + (north - top) * _DEGREE_M * scale
        boxes.append((row, (x - (grown[0] - size[0]) / 2, y - (grown[1] - size[1]) / 2, *grown)))
    bar_m = bar_length(_WIDTH / 4 / scale)
    return {
        "boxes": boxes,
        "bounds": (west, east, south, north),
        "width": max(wide * scale + 2 * _EDGE, _LEAST_WIDTH),
        "height": high * scale + 2 * _EDGE + 16,
        "bar": bar_m * scale,
        "bar_m": bar_m,
        "missing": len(rows) - len(found),
    }


def _box(row: SurveyRow) -> tuple[float, float, float, float] | None:
    """Return west, south, east and north of a survey in WGS 84, degrees; None if they are not known."""
    left, bottom, right, top = row.min_x, row.min_y, row.max_x, row.max_y
    if row.crs is None or left is None or bottom is None or right is None or top is None:
        return None
    try:
        west, south, east, north = _to_degrees(row.crs).transform_bounds(left, bottom, right, top)
    except ProjError:
        return None
    if not all(map(math.isfinite, (west, south, east, north))) or west > east:
        return None
    return west, south, east, north


@cache
def _to_degrees(crs: str) -> Transformer:
    return Transformer.from_crs(stated_crs(crs), "EPSG:4326", always_xy=True)


_SIDES = ((96, 12), (96, 5), (64, 5), (48, 3), (32, 2))
"""Pixels of the longer side and shades of each colour: the first that fits is taken."""
_COLOURS = np.array(
    [
        *(CLASS_COLOURS[number][:3] for number in range(len(CLASS_NAMES))),
        *([0.35 * part for part in CLASS_COLOURS[number][:3]] for number in range(len(CLASS_NAMES))),
        BARRED_COLOURS[Barred.UNKNOWN][:3],
    ],
    np.float64,
)
"""Of the classes, of the same where the ground is not passable, and of unknown ground."""
_BARRED, _UNKNOWN, _NOTHING = len(CLASS_NAMES), 2 * len(CLASS_NAMES), 2 * len(CLASS_NAMES) + 1
_LIGHT = (-0.5, 0.5, 0.7071)
"""Towards the sun in the north-west, 45 degrees high: east, north, up."""
_DARKEST, _BRIGHTEST = 0.45, 1.2
_MOST_PIXELS = 20_000_000
"""Heights of a virtual raster to average."""


def read_thumbnail(folder: Path | RemoteFolder, most_bytes: int) -> bytes:
    """Return a PNG of a complete map, in one folder or in sheets; empty if none is small enough.

    It is made from the overviews, so that memory and time do not grow with the map.

    Parameters
    ----------
    folder : Path or RemoteFolder
    most_bytes : int
        Largest size of the PNG.

    Raises
    ------
    BadInputError
        A layer is missing or damaged.
    """
    kind, shade = _read(folder, _SIDES[0][0])
    for side, shades in _SIDES:
        levels = np.linspace(_DARKEST, _BRIGHTEST, shades)
        nearest = np.rint((shade - _DARKEST) / (_BRIGHTEST - _DARKEST) * (shades - 1)).astype(np.intp)
        # A palette of its own: one that fits the picture would mix the colours of rare kinds of ground.
        palette = np.vstack([(_COLOURS[:, None] * levels[:, None]).reshape(-1, 3), np.full((1, 3), 255.0)])
        index = np.where(kind == _NOTHING, len(palette) - 1, kind * shades + nearest).astype(np.uint8)
        picture = Image.fromarray(index, "P")
        picture.putpalette(np.clip(np.rint(palette), 0, 255).astype(np.uint8).tobytes())
        picture.thumbnail((side, side), Image.Resampling.NEAREST)
        packed = io.BytesIO()
        picture.save(packed, "PNG", optimize=True)
        if packed.tell() <= most_bytes:
            return packed.getvalue()
    return b""


def _read(folder: Path | RemoteFolder, side: int) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the kind of ground (class, class plus ``_BARRED``, ``_UNKNOWN``, ``_NOTHING``) and its brightness.

    Both have ``side`` pixels along the longer side.
    """
    with open_raster(folder, "class.tif") as raster:
        scale = side / max(raster.height, raster.width)
        shape = max(1, round(raster.height * scale)), max(1, round(raster.width * scale))
        wide, high = raster.bounds.right - raster.bounds.left, raster.bounds.top - raster.bounds.bottom
        class_id = raster.read(1, out_shape=shape)
    with open_raster(folder, "barred.tif") as raster:
        barred = raster.read(1, out_shape=shape)
    # A tile may have a class although it is not known whether it can be crossed.
    unknown = (barred == Barred.UNKNOWN) | (class_id == NO_CLASS)
    kind = np.where(barred == Barred.NO, class_id, class_id + np.intp(_BARRED))
    kind = np.where(barred == NO_CLASS, _NOTHING, np.where(unknown, _UNKNOWN, kind)).astype(np.intp)
    return kind, _shade(_heights(folder, shape), (high / shape[0], wide / shape[1]))


def _heights(folder: Path | RemoteFolder, shape: tuple[int, int]) -> NDArray[np.float64]:
    from rasterio.enums import Resampling

    with open_raster(folder, "heightmap.tif") as raster:
        # GDAL may average every pixel of a virtual raster, also those between sheets that lie far apart. The overviews
        # of large sheets are averages already.
        large = raster.driver == "VRT" and raster.height * raster.width > _MOST_PIXELS
        how = Resampling.nearest if large else Resampling.average
        heights: NDArray[np.float64] = raster.read(1, out_shape=shape, resampling=how)
    return heights


def _shade(heights: NDArray[np.float64], pixel: tuple[float, float]) -> NDArray[np.float64]:
    """Return the brightness of the relief, 1 where it is level or not known."""
    if min(heights.shape) < 2:
        return np.ones(heights.shape)
    down, east = np.gradient(heights, *pixel)
    light = (_LIGHT[0] * -east + _LIGHT[1] * down + _LIGHT[2]) / np.sqrt(1.0 + east**2 + down**2)
    shade = np.clip(light / _LIGHT[2], _DARKEST, _BRIGHTEST)
    return np.where(np.isnan(shade), 1.0, shade)


_ORDER: tuple[SurveyStatus, ...] = ("failed", "incomplete", "not reached", "done", "already done")
"""What needs a look comes first."""


@dataclass(frozen=True, slots=True)
class SurveyView:
    """What the page shows of the layers of a survey beside its row."""

    thumbnail: bytes = b""
    """PNG; empty: there is none."""
    has_report: bool = False
    """Whether there is a report.html beside the layers."""


def index_page(
    rows: Sequence[SurveyRow], views: Mapping[str, SurveyView], links: Sequence[str], title: str, note: str = ""
) -> str:
    """Return a page that requests nothing but what the reader follows a link to.

    All text from rows is escaped; scripts and styles other than the page's own are refused by its policy.

    Parameters
    ----------
    rows : sequence of SurveyRow
    views : mapping
        By name of a survey; those without one have no picture.
    links : sequence of str
        Files beside the page to link to.
    title : str
        Name of the batch.
    note : str, optional
        A sentence below the headline, such as when the page was written.
    """
    from bumpymap.layers.report.page import render_page

    shown = sorted(rows, key=lambda row: (_ORDER.index(row.status), row.name))
    return render_page(
        "batch.html",
        style="batch.css",
        script="batch.js",
        links=links,
        note=note,
        order={status: place for place, status in enumerate(_ORDER)},
        places=_places(shown),
        rows=shown,
        shares_of=_shares,
        title=title,
        unknown_colour=BARRED_COLOURS[Barred.UNKNOWN],
        views=views,
    )


def _shares(row: SurveyRow) -> list[tuple[str, tuple[int, ...], float, str]]:
    """Return names, colours and shares of the classes and of unknown ground; empty if one is not known."""
    shares = [row.share_smooth, row.share_fair, row.share_rough, row.share_very_rough, row.share_unknown]
    known = [share for share in shares if share is not None]
    if len(known) < len(shares):
        return []
    colours = [*(CLASS_COLOURS[number] for number in range(len(CLASS_NAMES))), BARRED_COLOURS[Barred.UNKNOWN]]
    told = shares_text(known, (len(CLASS_NAMES),), 1)
    return list(zip((*CLASS_NAMES, "unknown"), colours, known, told, strict=True))


_BOUNDS = ("min_x", "min_y", "max_x", "max_y")
_RASTER = "class.tif"


def map_facts(folder: Path | RemoteFolder) -> dict[str, Any]:
    """Return the columns of a `SurveyRow` that follow from the layers of a complete map.

    Raises
    ------
    BadInputError
        The folder holds no complete map, or one that cannot be read.
    """
    manifest = _manifest_of(folder)
    try:
        return {**_counted(manifest), **_described(manifest), **_bounds(folder)}
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise BadInputError(f"the run.json in {_name(folder)} cannot be read as that of a map: {error!r}") from error


def _counted(manifest: dict[str, Any]) -> dict[str, Any]:
    counts, tiles = manifest["counts"], manifest["counts"]["tiles"]
    area = tiles * manifest["grid"]["tile_size_m"] ** 2
    reasons = counts["by_reason"]
    shares = {f"share_{name.replace(' ', '_')}": counts["by_class"][name] / tiles for name in CLASS_NAMES}
    return {
        "points": manifest["points"],
        "density": round(manifest["points"] / area, 4),
        "area": round(area, 2),
        "tiles": tiles,
        **{name: round(share, 6) for name, share in shares.items()},
        "share_passable": round(counts["passable"] / tiles, 6),
        "share_unknown": round(counts["unknown"] / tiles, 6),
        "unknown_reason": max(reasons, key=reasons.__getitem__) if reasons else None,
    }


def _described(manifest: dict[str, Any]) -> dict[str, Any]:
    crs, calibration = manifest["crs"], manifest["calibration"]
    sums = [str(file["checksum"]) for file in manifest["inputs"] if file.get("checksum")]
    return {
        "seconds": round(sum(manifest["seconds"].values()), 3),
        "crs": None if crs is None else crs["code"] or crs["name"],
        "vehicle": calibration["vehicle"],
        "calibration": calibration["id"],
        "checksum": " ".join(sums) or None,
        "warnings": tuple(map(str, manifest.get("warnings", ()))),
    }


def _bounds(folder: Path | RemoteFolder) -> dict[str, float]:
    with open_raster(folder, _RASTER) as raster:
        return dict(zip(_BOUNDS, map(float, raster.bounds), strict=True))


def _manifest_of(folder: Path | RemoteFolder) -> dict[str, Any]:
    if isinstance(folder, Path):
        return read_manifest(folder)
    found = folder.manifest()
    if found is None:
        raise BadInputError(f"{folder.url} holds no complete run: run.json is missing or not that of a map")
    return found


def _name(folder: Path | RemoteFolder) -> str:
    return str(folder) if isinstance(folder, Path) else folder.url


BATCH_LOG = "log.jsonl"
_CSV, _PARQUET, _PAGE = "summary.csv", "summary.parquet", "index.html"
BATCH_NAMES = (_CSV, _PARQUET, _PAGE, CATALOG_NAME, BATCH_LOG)
"""Files of a batch in its folder, beside the folders of the surveys."""
_MAP = "run.json"
_MOST_LINE = 100_000
"""Bytes of the first line of a file that are read at most."""


def check_batch_out(out: Path) -> None:
    """Raise OutputError if a folder holds files that are not those of a batch, where its own would be written."""
    if out.exists() and not out.is_dir():
        raise OutputError(f"cannot write to the folder {out}: it is a file. Choose another `out`")
    if lexists(out / _MAP):
        raise OutputError(f"{out} holds the layers of one map ({_MAP}). Choose another `out` for a batch of surveys")
    present = [name for name in BATCH_NAMES if lexists(out / name)]
    for name in present:
        if (out / name).is_symlink() or not (out / name).is_file():
            raise OutputError(f"{out / name} is a link or no file, and was not touched. Remove it")
    if present and not (_is_log(out / BATCH_LOG) or _first_line(out / _CSV) == _header()):
        raise OutputError(
            f"{out} holds {', '.join(present)}, which no batch has written. Choose another `out`, or remove them"
        )


def write_batch_summary(
    rows: Sequence[SurveyRow], folder: Path, views: Mapping[str, SurveyView], title: str, note: str = ""
) -> None:
    """Write summary.csv, summary.parquet and index.html, all or none.

    Parameters
    ----------
    rows : sequence of SurveyRow
    folder : Path
        An existing folder. The page links to the log and the catalogue in it.
    views, title, note
        See `index_page`.

    Raises
    ------
    OutputError
        The files cannot be written.
    """
    links = [_CSV, _PARQUET, *(name for name in (BATCH_LOG, CATALOG_NAME) if (folder / name).is_file())]
    try:
        with write_together(folder, _CSV) as staged, utf8_path(staged) as path:
            names = [column.name for column in fields(SurveyRow)]
            table = ([_cell(getattr(row, name)) for name in names] for row in rows)
            write_csv(path / _CSV, names, table, end="\n")
            _write_parquet(rows, path / _PARQUET)
            (path / _PAGE).write_text(index_page(rows, views, links, title, note), encoding="utf-8")
    except OSError as error:
        raise OutputError(
            f"cannot write the summary to {folder}: {error}. {write_remedy(error, 'Free some space there')}"
        ) from error


def _cell(value: Any) -> Any:
    """Return text in one line; several texts in one cell."""
    value = " | ".join(value) if isinstance(value, tuple) else value
    return " ".join(value.split()) if isinstance(value, str) else value


def _write_parquet(rows: Sequence[SurveyRow], path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {int: pa.int64(), float: pa.float64()}
    columns = [
        pa.field(
            column.name,
            next((kinds[kind] for kind in get_args(column.type) if kind in kinds), pa.string()),
            nullable=NoneType in get_args(column.type),
            metadata=dict(column.metadata) or None,
        )
        for column in fields(SurveyRow)
    ]
    # Text shows what it holds, as in summary.csv: here it may be a formula.
    cells = [[_cell(getattr(row, column.name)) for row in rows] for column in columns]
    values = [[escape_controls(cell) if isinstance(cell, str) else cell for cell in column] for column in cells]
    arrays = [pa.array(own, column.type) for own, column in zip(values, columns, strict=True)]
    pq.write_table(pa.table(arrays, schema=pa.schema(columns)), path, compression="zstd")


def _header() -> str:
    return ",".join(column.name for column in fields(SurveyRow))


def _is_log(path: Path) -> bool:
    try:
        first = parse_json(_first_line(path))
    except ValueError:
        return False
    return isinstance(first, dict) and {"time", "event"} <= set(first)


def _first_line(path: Path) -> str:
    """Return the first line of a file; empty if it cannot be read. A link is not followed."""
    try:
        with open_regular(path, os.O_NOFOLLOW) as file:
            return file.readline(_MOST_LINE).decode("utf-8", "replace").rstrip("\r\n")
    except OSError:
        return ""
