"""tiles.parquet, written and read back: one row for each tile with points."""

import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import shapely
from numpy.typing import NDArray

from bumpymap.core import (
    BANDS,
    BARRED_TEXT,
    GROUND_SOURCE,
    NO_CLASS,
    REASON_TEXT,
    SIDES,
    TEXTURES,
    BadInputError,
    Barred,
    CostTable,
    Reason,
    atomic,
    free_memory,
    tile_columns,
)
from bumpymap.layers.placement import Placement
from bumpytiles import TileTable

_ROW_GROUP = 16_384
"""Most tiles in a row group: 15 MB of heights at 15 x 15 pixels."""
_SIDES_OF_BOX = ("xmin", "ymin", "xmax", "ymax")
_BOX = pa.struct([pa.field(side, pa.float64(), nullable=False) for side in _SIDES_OF_BOX])
_NUMBERS = ("count", "reason", "z_min", "z_max", "relief", *(f"step_{side}" for side in SIDES))


def write_tiles(table: CostTable, path: Path, about: Mapping[str, str] | None = None) -> None:
    """Write tiles.parquet: GeoParquet 1.1, one row per tile, with a bounding box column as covering of the geometry.

    Rows are in the order of `TileTable.strips`: strips are one row of blocks high and come north first, then west
    first; so do the tiles within a strip. Unknown numbers are null; pixels of ``heights`` without points are NaN.
    ``about`` is metadata of the file, such as vehicle and calibration. Raises OutputError: the file cannot be written;
    BadInputError: the extent is too large for a raster.
    """
    place = Placement.of(table)
    fields = tile_fields(place.grid.pixels, has_source=table.tiles.has(GROUND_SOURCE.name))
    schema = pa.schema(fields, metadata={**(about or {}), "geo": json.dumps(_geo(place))})
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
        for found in _groups(table.tiles):
            writer.write_table(_rows(found, place, schema))


def _groups(tiles: TileTable) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the columns of each row group, which takes as many strips as fit."""
    names = [column.name for column in (*tile_columns(tiles.grid.pixels), GROUND_SOURCE)]
    names = list(filter(tiles.has, names))
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


def tile_fields(pixels: int, *, has_source: bool = False) -> list[pa.Field]:
    """Return the columns of tiles.parquet for tiles of pixels x pixels, with what describes each.

    ``has_source``: whether there is the column ``ground_source``, which only some maps have.
    """
    kinds = {column.name: pa.from_numpy_dtype(column.dtype) for column in tile_columns(pixels)}
    kinds["passable"] = pa.bool_()
    return [
        described_field("col", pa.int32(), "tile column: floor(x / tile_size), x in metres", nullable=False),
        described_field(
            "row", pa.int32(), "tile row: floor(y / tile_size), y in metres; grows to the north", nullable=False
        ),
        described_field("geometry", pa.binary(), "the tile, in the survey's CRS", nullable=False),
        described_field("bbox", _BOX, "bounds of the tile, in the survey's CRS", nullable=False),
        *(described_field(band.name, kinds[band.name], band.description, band.unit) for band in BANDS),
        *(described_field(f"step_{side}", pa.float32(), f"height step at the {side} side", "m") for side in SIDES),
        described_field("barred", pa.string(), "why it is not passable"),
        described_field("count", pa.int64(), "points that were measured", nullable=False),
        described_field("z_min", pa.float64(), "lowest point", "m"),
        described_field("z_max", pa.float64(), "highest point", "m"),
        described_field("relief", pa.float64(), "max - min of the heights with their plane taken off", "m"),
        described_field("texture", pa.string(), "the most probable texture"),
        *(described_field(f"p_{texture}", pa.float32(), f"probability of texture {texture}") for texture in TEXTURES),
        described_field("class", pa.int8(), "0 (flattest) to 3 (roughest)"),
        described_field("reason", pa.int8(), "why there is no class; 0 where there is one", nullable=False),
        described_field("reason_text", pa.string(), "the reason in words", nullable=False),
        described_field("heights", pa.list_(pa.float32(), pixels**2), "mean z of each pixel, north row first", "m"),
        *((_SOURCE,) if has_source else ()),
    ]


def described_field(name: str, kind: pa.DataType, text: str, unit: str = "", *, nullable: bool = True) -> pa.Field:
    """Return a column with what describes it."""
    notes = {"description": text} | ({"unit": unit} if unit else {})
    return pa.field(name, kind, nullable=nullable, metadata=notes)


_PARTS = "0: measured from points of ground classes, 1: from all points, where the survey is not classified"
_SOURCE = described_field(GROUND_SOURCE.name, pa.int8(), _PARTS, nullable=False)


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


def _rows(found: dict[str, NDArray[Any]], place: Placement, schema: pa.Schema) -> pa.Table:
    """Convert columns of tiles to rows of the file."""
    col, row = found["col"], found["row"]
    west, south, east, north = (place.to_crs(side) for side in (col, row, col + 1, row + 1))
    chance = found["probability"]
    best = np.where(np.isfinite(chance).all(axis=1), np.argmax(np.nan_to_num(chance), axis=1), len(TEXTURES))
    heights = pa.array(found["heights"].reshape(-1), pa.float32())
    columns: dict[str, Any] = {
        "col": col,
        "row": row,
        "geometry": shapely.to_wkb(shapely.box(west, south, east, north), byte_order=1),
        "bbox": pa.StructArray.from_arrays([west, south, east, north], fields=list(_BOX)),
        "texture": np.array([*TEXTURES, None], dtype=object)[best],
        "class": pa.array(found["class_id"], pa.int8(), mask=found["class_id"] == NO_CLASS),
        "barred": np.array([None, *(BARRED_TEXT[code] for code in Barred if code)], dtype=object)[found["barred"]],
        "reason_text": np.array([REASON_TEXT[code] for code in Reason], dtype=object)[found["reason"]],
        "heights": pa.FixedSizeListArray.from_arrays(heights, place.grid.pixels**2),
    }
    columns |= {name: found[name] for name in (*_NUMBERS, *(band.name for band in BANDS))}
    columns |= {name: found[name] for name in (GROUND_SOURCE.name,) if name in found}
    columns["passable"] = found["passable"] > 0
    columns["zone"] = pa.array(found["zone"], mask=found["zone"] == 0)
    columns |= {f"p_{texture}": chance[:, number] for number, texture in enumerate(TEXTURES)}
    return pa.table([typed_array(columns[field.name], field) for field in schema], schema=schema)


def typed_array(values: Any, field: pa.Field) -> pa.Array:
    """Return an array of the field's type in which None and NaN are null."""
    if isinstance(values, pa.NullArray):
        return values.cast(field.type)
    return values if isinstance(values, pa.Array) else pa.array(values, field.type, from_pandas=True)


_PAGE_NUMBERS = ("c_r", "p_fail", "slope", "obstacle")
_READ = ["col", "row", "class", "reason", "barred", "zone", *_PAGE_NUMBERS]
_AGAIN = "Map the survey again"
_BYTES = {"BOOLEAN": 1, "INT32": 4, "INT64": 8, "FLOAT": 4, "DOUBLE": 8}
"""Bytes of a value in memory, by its type in the file, where runs of equal values take next to nothing."""
_MOST_ROWS = 65_536
"""Rows of a group, which is read at once: four times those that are written."""


def read_tiles(path: Path, tiles: int) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the columns of some tiles at a time; numbers are NaN and classes ``NO_CLASS`` where unknown, zones 0.

    ``path``: tiles.parquet; ``tiles``: tiles that the run counts. Another number of rows is refused before any is read.
    Raises BadInputError: the file is missing, damaged, not of this run, or does not fit into memory.
    """
    try:
        with pq.ParquetFile(path, read_dictionary=["barred"]) as file:
            missing = set(_READ) - set(file.schema_arrow.names)
            if missing:
                raise BadInputError(f"{path} has no column {min(missing)}. {_AGAIN}")
            _require_rows(path, file.metadata, tiles)
            for group in range(file.num_row_groups):
                _require_memory(path, file.metadata, [group], _READ)
                yield _arrays(file.read_row_group(group, columns=_READ, use_threads=False))
    except (OSError, pa.ArrowException) as error:
        raise BadInputError(f"cannot read {path}: {error}. {_AGAIN}") from error


def require_tiles(path: Path, tiles: int) -> None:
    """Raise BadInputError if tiles.parquet has other rows than the run counts tiles, or does not fit into memory."""
    about = pq.read_metadata(path)
    _require_rows(path, about, tiles)
    _require_memory(path, about, range(about.num_row_groups))


def _require_rows(path: Path, about: pq.FileMetaData, tiles: int) -> None:
    if about.num_rows != tiles:
        raise BadInputError(
            f"{path} holds {about.num_rows:,} rows, and run.json counts {tiles:,} tiles: it is of another run. {_AGAIN}"
        )
    largest = max((about.row_group(group).num_rows for group in range(about.num_row_groups)), default=0)
    if largest > _MOST_ROWS:
        raise BadInputError(
            f"{path} has a group of {largest:,} rows; at most {_MOST_ROWS:,} are read at once. {_AGAIN}"
        )


def _require_memory(path: Path, about: pq.FileMetaData, groups: Iterable[int], names: Collection[str] = ()) -> None:
    """Raise BadInputError if columns (all without ``names``) of groups of rows take more memory than is free."""
    parts = [about.row_group(group).column(number) for group in groups for number in range(about.num_columns)]
    size = sum(
        max(part.total_uncompressed_size, part.num_values * _BYTES.get(part.physical_type, 0))
        for part in parts
        if not names or part.path_in_schema.partition(".")[0] in names
    )
    free = free_memory()
    if free is not None and size > free:
        raise BadInputError(
            f"{path} takes {size / 1e6:,.0f} MB of memory, and {free / 1e6:,.0f} MB are free. Read it on another "
            "machine, or map the survey in parts"
        )


def _arrays(table: pa.Table) -> dict[str, NDArray[Any]]:
    codes = {text: int(code) for code, text in BARRED_TEXT.items()}
    words = table["barred"].combine_chunks()
    words = words if pa.types.is_dictionary(words.type) else words.dictionary_encode()
    names = np.array([*(codes.get(name, Barred.UNKNOWN) for name in words.dictionary.to_pylist()), Barred.NO], np.uint8)
    # Numbers with nulls become real ones with NaN: `fill_null` would import all functions of Arrow.
    index = np.nan_to_num(words.indices.to_numpy(zero_copy_only=False), nan=len(names) - 1).astype(np.intp)
    whole = {name: table[name].to_numpy() for name in ("col", "row", "reason")}
    numbers = {name: table[name].to_numpy().astype(np.float32) for name in _PAGE_NUMBERS}
    classes = np.nan_to_num(table["class"].to_numpy(), nan=NO_CLASS).astype(np.uint8)
    zone = np.nan_to_num(table["zone"].to_numpy()).astype(np.int32)
    return whole | numbers | {"class": classes, "barred": names[index], "zone": zone}
