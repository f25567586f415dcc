"""Write all files of a map to its folder, tiles.parquet among them, the manifest last; recognise a complete folder."""

import json
import logging
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from functools import partial
from os.path import lexists
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import shapely
from numpy.typing import NDArray

from bumpymap.core import (
    BANDS,
    BARRED_TEXT,
    NO_CLASS,
    REASON_TEXT,
    SIDES,
    TEXTURES,
    BadInputError,
    Barred,
    CostTable,
    Georeference,
    OutputError,
    Progress,
    Reason,
    SilentProgress,
    atomic,
    describe_crs,
    read_record,
    speed_bands,
    tile_columns,
    vertical_of,
    write_together,
)
from bumpymap.layers.colours import class_limits
from bumpymap.layers.geotiff import (
    write_barred,
    write_classes,
    write_cost,
    write_heightmap,
    write_obstacles,
    write_passage,
    write_reasons,
    write_relief,
    write_roughness,
    write_speeds,
)
from bumpymap.layers.gis import write_project, write_styles
from bumpymap.layers.manifest import MANIFEST_NAME, complete_manifest, describe_file, software_versions, write_manifest
from bumpymap.layers.placement import Placement
from bumpymap.layers.products import EVERY_NAME, EVERY_VIEW_NAME, ITEM_NAME, PRODUCT_NAMES, SPEEDS_NAME, VIEW_NAMES
from bumpymap.layers.regions import dissolve
from bumpymap.layers.sheets.folders import remove_speeds
from bumpymap.layers.stac import write_item
from bumpymap.layers.summary import MapSummary, summarise
from bumpymap.layers.vector import GeoJsonCoordinates, flatgeobuf_writer, geojson_writer
from bumpytiles import TileTable

__all__ = [
    "as_tags",
    "is_complete",
    "layer_metadata",
    "refuse_replacing",
    "verified_record",
    "write_products",
    "write_tiles",
    "write_views",
]

_ROW_GROUP = 16_384
"""Most tiles in a row group: 15 MB of heights at 15 x 15 pixels."""
_SIDES_OF_BOX = ("xmin", "ymin", "xmax", "ymax")
_BOX = pa.struct([pa.field(side, pa.float64(), nullable=False) for side in _SIDES_OF_BOX])
_NUMBERS = ("count", "reason", "z_min", "z_max", "relief", *(f"step_{side}" for side in SIDES))


def write_tiles(table: CostTable, path: Path, about: Mapping[str, str] | None = None) -> None:
    """Write tiles.parquet: GeoParquet 1.1, one row per tile, with a bounding box column as covering of the geometry.

    Rows are in the order of `TileTable.strips`: strips are one row of blocks high and come north first, then west
    first; so do the tiles within a strip. Unknown numbers are null; pixels of ``heights`` without points are NaN.
    ``about`` is metadata of the file, such as vehicle and calibration.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        The extent is too large for a raster.
    """
    place = Placement.of(table)
    schema = _schema(place, about or {}, table.speeds)
    with (
        atomic(path, (pa.ArrowException,)) as temporary,
        pq.ParquetWriter(
            temporary,
            schema,
            compression="zstd",
            use_dictionary=["texture", "reason_text", "barred"],
            # Measured 17 % smaller than the default encoding, and faster to compress; for the boxes, a tenth of it.
            column_encoding=dict.fromkeys(
                ("heights.list.element", *(f"bbox.{side}" for side in _SIDES_OF_BOX)), "BYTE_STREAM_SPLIT"
            ),
        ) as writer,
    ):
        for found in _groups(table.tiles, len(table.speeds)):
            writer.write_table(_rows(found, place, schema, table.speeds))


def _groups(tiles: TileTable, speeds: int) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the columns of each row group, which takes as many strips as fit."""
    names = [column.name for column in tile_columns(tiles.grid.pixels, speeds)]
    held: list[dict[str, NDArray[Any]]] = []
    for strip in tiles.strips(_ROW_GROUP):
        found = tiles.read(names, strip)
        if sum(len(part["col"]) for part in [*held, found]) > _ROW_GROUP:
            yield _join(held)
        held.append(found)
        del found
    yield _join(held)


def _join(held: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Concatenate strips, and empty the list and its parts to free memory early."""
    parts, held[:] = held[:], []
    return {name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])}


def _schema(place: Placement, about: Mapping[str, str], speeds: tuple[float, ...]) -> pa.Schema:
    kinds = {column.name: pa.from_numpy_dtype(column.dtype) for column in tile_columns(place.grid.pixels)}
    kinds["passable"] = pa.bool_()
    fields = [
        _field("col", pa.int32(), "tile column: floor(x / tile_size), x in metres", nullable=False),
        _field("row", pa.int32(), "tile row: floor(y / tile_size), y in metres; grows to the north", nullable=False),
        _field("geometry", pa.binary(), "the tile, in the survey's CRS", nullable=False),
        _field("bbox", _BOX, "bounds of the tile, in the survey's CRS", nullable=False),
        *(_field(band.name, kinds[band.name], band.description, band.unit) for band in BANDS),
        *(_field(f"step_{side}", pa.float32(), f"height step at the {side} side", "m") for side in SIDES),
        _field("barred", pa.string(), "why it is not passable"),
        _field("count", pa.int64(), "points that were measured", nullable=False),
        _field("z_min", pa.float64(), "lowest point", "m"),
        _field("z_max", pa.float64(), "highest point", "m"),
        _field("relief", pa.float64(), "max - min of the heights with their plane taken off", "m"),
        _field("texture", pa.string(), "the most probable texture"),
        *(_field(f"p_{texture}", pa.float32(), f"probability of texture {texture}") for texture in TEXTURES),
        _field("class", pa.int8(), "0 (flattest) to 3 (roughest)"),
        _field("reason", pa.int8(), "why there is no class; 0 where there is one", nullable=False),
        _field("reason_text", pa.string(), "the reason in words", nullable=False),
        *(_field(band.name, pa.float32(), band.description, band.unit) for band in speed_bands(speeds)),
        _field("heights", pa.list_(pa.float32(), place.grid.pixels**2), "mean z of each pixel, north row first", "m"),
    ]
    return pa.schema(fields, metadata={**about, "geo": json.dumps(_geo(place))})


def _field(name: str, kind: pa.DataType, text: str, unit: str = "", *, nullable: bool = True) -> pa.Field:
    notes = {"description": text} | ({"unit": unit} if unit else {})
    return pa.field(name, kind, nullable=nullable, metadata=notes)


def _geo(place: Placement) -> dict[str, Any]:
    """Return the ``geo`` metadata of GeoParquet 1.1.0."""
    crs = place.height_crs
    window = place.window
    corners = np.array([window.col, window.row, window.col + window.cols, window.row + window.rows])
    geometry = {
        "encoding": "WKB",
        "geometry_types": ["Polygon"],
        "crs": None if crs is None else crs.to_json_dict(),
        "orientation": "counterclockwise",
        "edges": "planar",
        "bbox": place.to_crs(corners).tolist(),
        "covering": {"bbox": {side: ["bbox", side] for side in _SIDES_OF_BOX}},
    }
    return {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": geometry}}


def _rows(found: dict[str, NDArray[Any]], place: Placement, schema: pa.Schema, speeds: tuple[float, ...]) -> pa.Table:
    """Convert columns of tiles to rows of the file."""
    col, row = found["col"], found["row"]
    west, south, east, north = (place.to_crs(side) for side in (col, row, col + 1, row + 1))
    chance = found["probability"]
    heights = pa.array(found["heights"].reshape(-1), pa.float32())
    columns: dict[str, Any] = {
        "col": col,
        "row": row,
        "geometry": shapely.to_wkb(shapely.box(west, south, east, north), byte_order=1),
        "bbox": pa.StructArray.from_arrays([west, south, east, north], fields=list(_BOX)),
        "texture": _texture(chance),
        "class": pa.array(found["class_id"], pa.int8(), mask=found["class_id"] == NO_CLASS),
        "barred": np.array([None, *(BARRED_TEXT[code] for code in Barred if code)], dtype=object)[found["barred"]],
        "reason_text": np.array([REASON_TEXT[code] for code in Reason], dtype=object)[found["reason"]],
        "heights": pa.FixedSizeListArray.from_arrays(heights, place.grid.pixels**2),
    }
    columns |= {name: found[name] for name in (*_NUMBERS, *(band.name for band in BANDS))}
    columns["passable"] = found["passable"] > 0
    columns |= {band.name: found["motion"][:, number] for number, band in enumerate(speed_bands(speeds))}
    columns |= {f"p_{texture}": chance[:, number] for number, texture in enumerate(TEXTURES)}
    return pa.table([_array(columns[field.name], field) for field in schema], schema=schema)


def _array(values: Any, field: pa.Field) -> pa.Array:
    """Return an array of the field's type in which None and NaN are null."""
    return values if isinstance(values, pa.Array) else pa.array(values, field.type, from_pandas=True)


def _texture(chance: NDArray[np.float32]) -> NDArray[np.object_]:
    names = np.array([*TEXTURES, None], dtype=object)
    known = np.isfinite(chance).all(axis=1)
    best = np.where(known, np.argmax(np.nan_to_num(chance), axis=1), len(TEXTURES))
    picked: NDArray[np.object_] = names[best]
    return picked


def layer_metadata(manifest: Mapping[str, Any], place: Georeference) -> dict[str, Any]:
    """Return the entries that layers carry as metadata, as texts and lists of numbers; what is not known is left out.

    Parameters
    ----------
    manifest : mapping
        The run's own entries for run.json, see `complete_manifest`.
    place : Georeference
        CRS of the survey.

    Returns
    -------
    dict
        ``survey``, ``survey_checksum``, ``survey_header_dates`` (first/last, ISO 8601), ``vehicle``, ``calibration``,
        ``speed_m_per_s`` and ``p_fail_speed_m_per_s`` (of a map at another speed), ``texture_model``, ``rating``,
        ``class_limits_rad_per_m``, ``bumpymap_version``, ``vertical_crs``.
    """
    survey, calibration = (_entries(manifest.get(name)) for name in ("survey", "calibration"))
    settings = _entries(manifest.get("settings"))
    is_papers = settings.get("compat") == "paper"
    dates, limits = survey.get("dates"), calibration.get("class_limits")
    entries = {
        "survey": survey.get("name"),
        "survey_checksum": survey.get("checksum"),
        "survey_header_dates": "/".join(dates) if dates else None,
        "vehicle": calibration.get("vehicle"),
        "calibration": calibration.get("id"),
        # Without it the speed is that of the vehicle's profile.
        "speed_m_per_s": settings.get("speed"),
        "p_fail_speed_m_per_s": _entries(manifest.get("vehicle")).get("drives_mps") if settings.get("speed") else None,
        "texture_model": manifest.get("model"),
        "rating": "paper" if is_papers else settings.get("rating"),
        # The paper's classes follow from its table of textures and z ranges.
        "class_limits_rad_per_m": [float(limit) for limit in limits] if limits and not is_papers else None,
        "bumpymap_version": software_versions().get("bumpymap"),
        "vertical_crs": _vertical(place),
    }
    return {name: value for name, value in entries.items() if value is not None}


def as_tags(metadata: Mapping[str, Any]) -> dict[str, str]:
    """Return metadata as texts, for formats that hold nothing else; numbers of a list are separated by spaces."""
    return {
        name: " ".join(map(str, value)) if isinstance(value, list) else str(value) for name, value in metadata.items()
    }


def _entries(value: Any) -> Mapping[str, Any]:
    """Return an entry of a manifest, which may be a mapping or a record; nothing if there is none."""
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    return value if isinstance(value, Mapping) else {}


def _vertical(place: Georeference) -> str:
    vertical = None if place.crs is None else vertical_of(place.crs)
    if vertical is None:
        return "none given; heights as in the survey, in metres"
    return f"{describe_crs(vertical)}; heights in metres"


_REMEDY = "Choose another `out`, or pass `overwrite=True` to replace it"


def is_complete(folder: Path, manifest: str = MANIFEST_NAME) -> bool:
    """Return whether a folder holds a complete run: the manifest is the last file that a run writes."""
    return lexists(folder / manifest)


@contextmanager
def verified_record(
    folder: Path, files: Collection[str] | None, manifest: str = MANIFEST_NAME
) -> Iterator[dict[str, Any]]:
    """Read the manifest of a complete run and verify the checksums of its files.

    Errors of the body of the ``with`` that mean a key is missing or malformed become an OutputError too.

    Parameters
    ----------
    folder : Path
    files : collection of str or None
        Files that must exist; those that the manifest lists are checked in any case. None: no file is checked, since
        the manifest alone is in the folder.
    manifest : str
        Name of the manifest.

    Raises
    ------
    OutputError
        The manifest cannot be read as that of a run or does not list a file, or a file is missing or has changed.
    """
    record = read_record(folder / manifest)
    unreadable = f"{folder} already holds a {manifest} that cannot be read as that of a run. {_REMEDY}"
    if record is None:
        raise OutputError(unreadable)
    try:
        listed = {str(file["path"]): str(file["sha256"]) for file in record["files"]}
        if files is not None:
            _verify(folder, files, listed)
        yield record
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise OutputError(unreadable) from error


def refuse_replacing(folder: Path, differences: Sequence[str]) -> None:
    """Raise OutputError if there are differences between the complete run in a folder and the requested one."""
    if differences:
        raise OutputError(
            f"{folder} already holds a complete run with other inputs or settings:",
            *(f"  {difference}" for difference in differences),
            _REMEDY,
        )


def _verify(folder: Path, files: Collection[str], listed: dict[str, str]) -> None:
    unknown = sorted(set(files) - set(listed))
    if unknown:
        raise OutputError(
            f"{folder} already holds a complete run of an earlier version of bumpymap, which did not write "
            f"{', '.join(unknown)}. {_REMEDY}"
        )
    for name, checksum in sorted(listed.items()):
        try:
            same = describe_file(folder / name)["sha256"] == checksum
        except BadInputError as error:
            raise OutputError(f"{folder} already holds a complete run, but {name} is missing. {_REMEDY}") from error
        if not same:
            raise OutputError(f"{folder} already holds a complete run, but {name} has changed since. {_REMEDY}")


_log = logging.getLogger(__name__)


def _report(folder: Path, record: Mapping[str, Any]) -> None:
    from bumpymap.layers.report.map_page import write_report  # Pillow takes some 10 ms to import

    write_report(folder, record)


_VIEWS: tuple[Callable[[Path, Mapping[str, Any]], None], ...] = (write_styles, write_project, _report)
"""Write the files of ``EVERY_VIEW_NAME`` to a folder, from the layers in it and the record of its run."""


def write_products(
    table: CostTable,
    folder: Path,
    *,
    local: bool,
    manifest: Mapping[str, Any],
    progress: Progress | None = None,
    around: TileTable | None = None,
) -> tuple[list[Path], MapSummary]:
    """Write all files of a run, or none; run.json is written last, so a folder that has one is complete.

    Files of an earlier run stay until all new ones are complete. Except for run.json, no file depends on the time, on
    the order of the tiles or on the output folder: the same map of the same survey has the same bytes.

    Parameters
    ----------
    table : CostTable
        The tiles.
    folder : Path
        An existing folder, see `check_folder`.
    local : bool
        Write cost.geojson in the survey's own coordinates if it has no CRS.
    manifest : mapping
        The run's own entries for run.json, see `complete_manifest`.
    progress : Progress, optional
        Counts the layers as they are written.
    around : TileTable, optional
        See `write_relief`.

    Returns
    -------
    list of Path
        The files, in the order of ``EVERY_NAME`` and ``EVERY_VIEW_NAME``.
    MapSummary
        Counts and medians of the map.

    Raises
    ------
    OutputError
        A file cannot be written.
    BadInputError
        The extent is too large for a raster, or there is no CRS and ``local`` is False.
    """
    started = time.perf_counter()
    placement = Placement.of(table)
    # Fail early: there may be no transformation from the survey's CRS to longitude and latitude.
    coordinates = GeoJsonCoordinates.of(placement, local=local)
    metadata = layer_metadata(manifest, table.georeference)
    progress = progress or SilentProgress()
    with write_together(folder, MANIFEST_NAME) as staged, ThreadPoolExecutor(1) as background:
        counting = background.submit(summarise, table, class_limits(manifest))
        try:
            layers = _write_layers(_layers(table, coordinates, staged, metadata, around), staged, progress)
            summary = counting.result()
        finally:
            background.shutdown(wait=False, cancel_futures=True)
        record = complete_manifest(manifest, table, summary, layers)
        write_views(staged, record)
        write_item(staged, record)
        record["seconds"] = {**manifest.get("seconds", {}), "write": round(time.perf_counter() - started, 3)}
        record["files"].append(describe_file(staged / ITEM_NAME) | {"path": ITEM_NAME})
        write_manifest(record, staged / MANIFEST_NAME)
    _log.info("wrote %d tiles to %s", summary.tiles, folder)
    if not table.speeds:
        remove_speeds(folder)
    names = (*EVERY_NAME, *EVERY_VIEW_NAME) if table.speeds else (*PRODUCT_NAMES, *VIEW_NAMES)
    return [folder / name for name in names], summary


def write_views(folder: Path, record: Mapping[str, Any]) -> None:
    """Write the files of ``EVERY_VIEW_NAME`` for the layers in a folder, from them and the content of run.json."""
    for view in _VIEWS:
        view(folder, record)


def _layers(
    table: CostTable,
    coordinates: GeoJsonCoordinates,
    folder: Path,
    metadata: Mapping[str, Any],
    around: TileTable | None,
) -> list[dict[tuple[str, ...], Callable[[], None]]]:
    """Return groups of functions that write layers, keyed by file names; a group is written one by one.

    Rasters take turns where GDAL writes them, see `_integrity`; two groups of them save time where it does not.
    """
    tags = as_tags(metadata)
    speeds: dict[tuple[str, ...], Callable[[], None]] = (
        {(SPEEDS_NAME,): partial(write_speeds, table, folder / SPEEDS_NAME, tags)} if table.speeds else {}
    )
    return [
        {
            ("heightmap.tif",): partial(write_heightmap, table, folder / "heightmap.tif", tags),
            ("relief.tif",): partial(write_relief, table, folder / "relief.tif", tags, around),
            ("obstacle.tif",): partial(write_obstacles, table, folder / "obstacle.tif", tags),
            ("passage.tif",): partial(write_passage, table, folder / "passage.tif", tags),
        },
        {
            ("roughness.tif",): partial(write_roughness, table, folder / "roughness.tif", tags),
            ("class.tif",): partial(write_classes, table, folder / "class.tif", tags),
            ("reason.tif",): partial(write_reasons, table, folder / "reason.tif", tags),
            ("cost.tif",): partial(write_cost, table, folder / "cost.tif", tags),
            ("barred.tif",): partial(write_barred, table, folder / "barred.tif", tags),
            **speeds,
        },
        {
            ("cost.geojson", "cost.fgb"): partial(_write_regions, table, coordinates, folder, metadata),
            ("tiles.parquet",): partial(write_tiles, table, folder / "tiles.parquet", tags),
        },
    ]


def _write_layers(
    groups: Sequence[Mapping[tuple[str, ...], Callable[[], None]]], folder: Path, progress: Progress
) -> list[dict[str, Any]]:
    """Write groups of layers in parallel; return name, size and checksum of each file in ``EVERY_NAME`` order."""
    stop = Event()

    def write(group: Mapping[tuple[str, ...], Callable[[], None]]) -> list[dict[str, Any]]:
        files = []
        for names, layer in group.items():
            if stop.is_set():
                break
            layer()
            files += [describe_file(folder / name) | {"path": name} for name in names]
            progress.advance(1)
        return files

    progress.start("writing layers", sum(map(len, groups)))
    with ThreadPoolExecutor(len(groups)) as pool:
        try:
            futures = [pool.submit(write, group) for group in groups]
            files = [file for future in as_completed(futures) for file in future.result()]
        finally:
            stop.set()
    return sorted(files, key=lambda file: EVERY_NAME.index(file["path"]))


def _write_regions(
    table: CostTable, coordinates: GeoJsonCoordinates, folder: Path, metadata: Mapping[str, Any]
) -> None:
    placement = coordinates.placement
    with (
        geojson_writer(folder / "cost.geojson", coordinates, metadata) as write_geojson,
        flatgeobuf_writer(folder / "cost.fgb", placement, as_tags(metadata)) as write_flatgeobuf,
    ):
        for regions in dissolve(table, placement):
            write_geojson(regions)
            write_flatgeobuf(regions)
