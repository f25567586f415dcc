"""summary.csv and summary.parquet: one row for each survey of a batch."""

import csv
import io
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from os.path import lexists
from pathlib import Path
from types import NoneType
from typing import Any, Literal, TypeAlias, get_args

from bumpymap.core import OutputError, parse_json, utf8_path, write_together
from bumpymap.layers.products import CATALOG_NAME

__all__ = ["BATCH_LOG", "BATCH_NAMES", "SurveyRow", "SurveyStatus", "check_batch_out", "write_batch_summary"]

SurveyStatus: TypeAlias = Literal["done", "already done", "incomplete", "failed", "not reached"]
"""``incomplete``: layers were written, but files were skipped, or too many tiles are unknown."""
BATCH_LOG = "log.jsonl"
_CSV, _PARQUET = "summary.csv", "summary.parquet"
BATCH_NAMES = (_CSV, _PARQUET, CATALOG_NAME, BATCH_LOG)
"""Files of a batch in its folder, beside the folders of the surveys."""
_MAP = "run.json"
_MOST_LINE = 100_000
"""Bytes of the first line of a file that are read at most."""


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
    seconds: float | None = _column("wall time of the run that made the layers, or until it failed", "s")
    survey: str = ""
    """Its files or folder, as the run was given them."""
    points: int | None = _column("points read that are neither withheld nor noise")
    density: float | None = _column("points per area of the tiles with points", "1/m2")
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


def write_batch_summary(rows: Sequence[SurveyRow], folder: Path) -> None:
    """Write summary.csv and summary.parquet, both or none.

    Raises
    ------
    OutputError
        The files cannot be written.
    """
    try:
        with write_together(folder, _CSV) as staged, utf8_path(staged) as path:
            (path / _CSV).write_bytes(_csv_text(rows).encode("utf-8", "backslashreplace"))
            _write_parquet(rows, path / _PARQUET)
    except OSError as error:
        raise OutputError(f"cannot write the summary to {folder}: {error}. Free some space there") from error


def _csv_text(rows: Sequence[SurveyRow]) -> str:
    names = [column.name for column in fields(SurveyRow)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([[_cell(getattr(row, name)) for name in names] for row in rows])
    return text.getvalue()


def _cell(value: Any) -> Any:
    """Return a value as text in one line; a float as short as it can be."""
    if isinstance(value, str):
        return " ".join(value.split())
    return "" if value is None else value


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
    values = [[_valid(getattr(row, column.name)) for row in rows] for column in columns]
    arrays = [pa.array(own, column.type) for own, column in zip(values, columns, strict=True)]
    pq.write_table(pa.table(arrays, schema=pa.schema(columns)), path, compression="zstd")


def _valid(value: Any) -> Any:
    """Return text as valid UTF-8: bytes of a file name that are not are written escaped, as in summary.csv."""
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


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
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return ""
    with os.fdopen(descriptor, "rb") as file:
        return file.readline(_MOST_LINE).decode("utf-8", "replace").rstrip("\r\n")
