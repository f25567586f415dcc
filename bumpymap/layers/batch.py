"""The files of a batch: summary.csv and summary.parquet with one row for each survey, catalogue, page."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from os.path import lexists
from pathlib import Path
from types import NoneType
from typing import Any, Literal, TypeAlias, get_args

from bumpymap.core import (
    CLASS_NAMES,
    OutputError,
    escape_controls,
    open_regular,
    utf8_path,
    write_csv,
    write_remedy,
    write_together,
)
from bumpymap.layers.manifest import MANIFEST_NAME, read_manifest
from bumpymap.layers.map_reader import open_layer
from bumpymap.layers.products import COLLECTION_NAME, MapFile, require_folder
from bumpymap.layers.stac import write_collection

SurveyStatus: TypeAlias = Literal["done", "already done", "incomplete", "failed", "not reached"]
"""``incomplete``: layers were written, but files were skipped, or too many tiles are unknown."""


def _column(description: str, unit: str = "") -> Any:
    return field(default=None, metadata={"description": description} | ({"unit": unit} if unit else {}))


@dataclass(frozen=True, slots=True)
class SurveyRow:
    """Result of one survey of a batch. None: not known, as for a survey without layers."""

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
    """Its files or folder, as the run was given them."""
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


def map_facts(folder: Path) -> dict[str, Any]:
    """Return the columns of a `SurveyRow` that follow from the layers of a complete map.

    Raises BadInputError: the folder holds no complete map, or one that cannot be read.
    """
    manifest = read_manifest(folder)
    with utf8_path(folder) as path, open_layer(path / MapFile.CLASS) as raster:
        bounds = dict(zip(("min_x", "min_y", "max_x", "max_y"), map(float, raster.bounds), strict=True))
    counts, tiles = manifest["counts"], manifest["counts"]["tiles"]
    area = tiles * manifest["grid"]["tile_size_m"] ** 2
    reasons = counts["by_reason"]
    shares = {f"share_{name.replace(' ', '_')}": counts["by_class"][name] for name in CLASS_NAMES}
    shares |= {"share_passable": counts["passable"], "share_unknown": counts["unknown"]}
    crs, calibration = manifest["crs"], manifest["calibration"]
    sums = [str(file["checksum"]) for file in manifest["inputs"] if file.get("checksum")]
    return {
        "points": manifest["points"],
        "density": round(manifest["points"] / area, 4) if tiles else None,
        "area": round(area, 2),
        "tiles": tiles,
        **{name: round(count / tiles, 6) if tiles else None for name, count in shares.items()},
        "unknown_reason": max(reasons, key=reasons.__getitem__) if reasons else None,
        "seconds": round(sum(manifest["seconds"].values()), 3),
        "crs": None if crs is None else crs["code"] or crs["name"],
        "vehicle": calibration["vehicle"],
        "calibration": calibration["id"],
        "checksum": " ".join(sums) or None,
        "warnings": tuple(map(str, manifest.get("warnings", ()))),
        **bounds,
    }


_CSV, _PARQUET, _PAGE = "summary.csv", "summary.parquet", "index.html"
BATCH_LINKS = (_CSV, _PARQUET, COLLECTION_NAME)
"""Files of a batch that its page links to."""
BATCH_NAMES = (*BATCH_LINKS, _PAGE)
"""Files of a batch in its folder, beside the folders of the surveys."""
_MOST_LINE = 100_000
"""Bytes of the first line of a file that are read at most: chosen, that of a summary has 500."""


def check_batch_out(out: Path) -> None:
    """Raise OutputError if a folder holds files that are not those of a batch, where its own would be written."""
    require_folder(out)
    if lexists(out / MANIFEST_NAME):
        raise OutputError(
            f"{out} holds the layers of one map ({MANIFEST_NAME}). Choose another `out` for a batch of surveys"
        )
    present = [name for name in BATCH_NAMES if lexists(out / name)]
    for name in present:
        if (out / name).is_symlink() or not (out / name).is_file():
            raise OutputError(f"{out / name} is a link or no file, and was not touched. Remove it")
    if present and _first_line(out / _CSV) != ",".join(column.name for column in fields(SurveyRow)):
        raise OutputError(
            f"{out} holds {', '.join(present)}, which no batch has written. Choose another `out`, or remove them"
        )


def write_batch_summary(rows: Sequence[SurveyRow], folder: Path, title: str, page: str) -> None:
    """Write summary.csv, summary.parquet, collection.json and index.html, all or none.

    ``title``: of the catalogue; ``page``: content of index.html. Raises OutputError: the files cannot be written.
    """
    try:
        with write_together(folder, _CSV) as staged, utf8_path(staged) as path:
            names = [column.name for column in fields(SurveyRow)]
            table = ([_cell(getattr(row, name)) for name in names] for row in rows)
            write_csv(path / _CSV, names, table, end="\n")
            _write_parquet(rows, path / _PARQUET)
            write_collection(
                path / COLLECTION_NAME, folder, [row.name for row in rows if row.status != "failed"], title
            )
            (path / _PAGE).write_text(page, encoding="utf-8")
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


def _first_line(path: Path) -> str:
    """Return the first line of a file; empty if it cannot be read. A link is not followed."""
    try:
        with open_regular(path, os.O_NOFOLLOW) as file:
            return file.readline(_MOST_LINE).decode("utf-8", "replace").rstrip("\r\n")
    except OSError:
        return ""
