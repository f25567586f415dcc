"""PLY and PCD scans: the survey readers open, check and decode; here the columns of a scan are taken from the rows."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.checks import decoding, refuse_count
from bumpymap.readers.frames.raw import RawScan
from bumpymap.readers.pcd import PcdSurvey
from bumpymap.readers.ply import PlySurvey
from bumpymap.readers.ply_header import read_ply_header
from bumpymap.readers.protocol import ReadOptions
from bumpymap.readers.source import Location, open_source
from bumpymap.readers.text_rows import TextRows

__all__ = ["read_pcd", "read_ply"]

_LABELS = ("label", "labels", "scalar_label", "semantic", "semantic_label", "sem_id")
_INTENSITIES = ("intensity", "scalar_intensity", "reflectivity", "remission")
_MOST_ID = 65_535


def read_ply(path: Location) -> RawScan:
    """Read a PLY scan; a property ``label`` gives the semantic ids."""
    survey = PlySurvey(path, ReadOptions())
    header = read_ply_header(path)
    if not header.text:
        return _from_rows(path, _all_rows(survey))
    vertex = header.vertex
    table = _text_table(path, header.data_at, header.lines_before, vertex.scalars, vertex.lists)
    return _from_rows(path, _rows_of(table, vertex.count))


def read_pcd(path: Location) -> RawScan:
    """Read a PCD scan: text, binary or compressed; a field ``label`` gives the semantic ids."""
    survey = PcdSurvey(path, ReadOptions())
    if not survey.info.format.endswith("ascii"):
        return _from_rows(path, _all_rows(survey))
    names, data_at = _pcd_columns(path)
    return _from_rows(path, _rows_of(_text_table(path, data_at, 0, names), survey.info.point_count))


def _all_rows(survey: PlySurvey | PcdSurvey) -> Any:
    rows = np.concatenate([survey.fetch(chunk) for chunk in survey.chunks()])
    refuse_count(survey.info.path, survey.info.point_count, len(rows))
    return rows


def _pcd_columns(path: Location) -> tuple[list[str], int]:
    """Name of every number of a line, and the byte where the lines start; the survey reader checked the header."""
    words: dict[str, list[str]] = {}
    with decoding(path, "the header"), open_source(path) as stream:
        while "DATA" not in words:
            first, *rest = stream.readline().decode("utf-8", "replace").split() or [""]
            words[first] = rest
        counts = words.get("COUNT", ["1"] * len(words["FIELDS"]))
        names = [
            name if number == 0 else f"{name}__{number}"
            for name, count in zip(words["FIELDS"], counts, strict=True)
            for number in range(int(count))
        ]
        return names, stream.tell()


def _text_table(path: Location, data_at: int, skipped: int, names: list[str], lists: tuple[bool, ...] = ()) -> TextRows:
    lower = [name.lower() for name in names]
    wanted = ["x", "y", "z", *(name for kind in (_LABELS, _INTENSITIES) for name in kind if name in lower)]
    dtype = np.dtype([(name, np.float64) for name in wanted])
    return TextRows(path, data_at, skipped, dtype, [lower.index(name) for name in wanted], lists)


def _rows_of(table: TextRows, count: int) -> Any:
    rows = table.read(0, count)
    table.close()
    refuse_count(table.path, count, len(rows))
    return rows


def _from_rows(path: Location, rows: Any) -> RawScan:
    names = {name.lower(): name for name in reversed(rows.dtype.names)}
    points = np.empty((len(rows), 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is dropped and counted
        for axis, name in enumerate("xyz"):
            points[:, axis] = rows[names[name]]
        intensity = next((rows[names[name]].astype(np.float32) for name in _INTENSITIES if name in names), None)
    label = next((_semantic(path, rows[names[name]]) for name in _LABELS if name in names), None)
    return RawScan(points, intensity, label)


def _semantic(path: Location, column: NDArray[Any]) -> NDArray[np.uint16]:
    ids = column.astype(np.float64)
    if not bool(((ids >= 0) & (ids <= _MOST_ID) & (ids == np.rint(ids))).all()):
        raise BadInputError(f"the labels of {path} are not all whole numbers from 0 to {_MOST_ID:,}: not semantic ids")
    return ids.astype(np.uint16)
