"""The reader of LAS, LAZ and COPC. lazrs decodes only the fields that bumpymap needs."""

from collections.abc import Sequence
from dataclasses import replace
from typing import BinaryIO

import numpy as np

from bumpymap.core import BadInputError, Georeference, Place, georeference
from bumpymap.readers.base import SurveyBase
from bumpymap.readers.checks import decoding, refuse_header_bounds
from bumpymap.readers.conversion import NO_POINTS, PointChecks, RecordLayout, convert_las_points
from bumpymap.readers.copc import count_points_outside_node, read_octree
from bumpymap.readers.geokeys import statement_of_las
from bumpymap.readers.las_header import RawHeader, read_raw_header
from bumpymap.readers.las_points import (
    LazChunks,
    LazStream,
    PlainPoints,
    PlainRecords,
    Records,
    RecordSource,
    has_huge_chunks,
)
from bumpymap.readers.laz_table import is_chunked, laz_record, read_table
from bumpymap.readers.line_sums import LineRules
from bumpymap.readers.protocol import CHUNK_POINTS, Chunk, ChunkPoints, ReadOptions, SurveyInfo
from bumpymap.readers.source import Location, open_source
from bumpytiles import DECIMALS, Bounds

__all__ = ["LasSurvey"]


class LasSurvey(SurveyBase):
    """A LAS, LAZ or COPC file.

    A coordinate is ``integer * scale + offset``, rounded to 1e-8 of the file's unit and then converted to metres. The
    rounding removes the last bits of the floating-point sum, which depend on the offset that a writer chose: a survey
    that is split into files with different offsets gives bit-identical points. 1e-8 is far below the resolution of LAS
    files (about 1e-3) and above that of float64 up to 6.7e7 units, so coordinates are not changed otherwise.
    """

    def __init__(self, path: Location, options: ReadOptions) -> None:
        with decoding(path, "the header"), open_source(path) as stream:
            raw = read_raw_header(stream, path)
            _refuse_scales(path, raw)
            place, notes = georeference(
                Place(path, _middle(raw)), statement_of_las(raw), options.given_crs, options.z_unit
            )
            bounds = None if options.trust_points else _bounds(raw, place)
            if bounds is not None:
                refuse_header_bounds(path, bounds)
            self._source = _source(stream, path, raw, None if bounds is None else place.metres_per_unit)
        self._layout = _layout(raw)
        self._lines = LineRules(measure=options.lines, corrections=options.corrections)
        kind = f"{'LAZ' if raw.compressed else 'LAS'} {raw.version}, point format {raw.point_format}"
        kind = f"COPC ({kind})" if raw.is_copc else kind
        notes += _degrees_note(place, raw)
        sequential, parallel = isinstance(self._source, LazStream), isinstance(self._source, LazChunks)
        info = SurveyInfo(path, kind, raw.size, raw.point_count, place, bounds, None, notes)
        super().__init__(replace(info, sequential=sequential, parallel=parallel, header_date=raw.created))

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Split the file between points, LAZ chunks, or nodes of the octree."""
        return self._source.chunks(points)

    def fetch(self, chunk: Chunk) -> Records | PlainRecords:
        """Read and decode the point records of a chunk; uncompressed ones are read when they are converted."""
        return self._source.fetch(chunk)

    def convert(self, chunk: Chunk, fetched: Records | PlainRecords) -> ChunkPoints:
        """Convert the records of a chunk to points in metres."""
        info = self.info
        checks = PointChecks(chunk.first, info.bounds)
        pieces = fetched if isinstance(fetched, PlainRecords) else (fetched,)
        converted = convert_las_points(pieces, chunk.points, self._layout, info.georeference, checks, self._lines)
        nodes = self._source.nodes(chunk)
        if isinstance(fetched, PlainRecords) or nodes is None or info.bounds is None:
            return converted
        points_outside_node = count_points_outside_node(
            fetched, self._layout, info.georeference.metres_per_unit, info.bounds, nodes
        )
        return (
            converted
            if not points_outside_node
            else ChunkPoints(NO_POINTS, replace(converted.stats, points_outside_node=points_outside_node))
        )


def _source(stream: BinaryIO, path: Location, raw: RawHeader, metres_per_unit: float | None) -> RecordSource:
    """Choose how to read the points; ``metres_per_unit`` is None if the bounds of octree nodes are to be ignored."""
    if not raw.compressed:
        return PlainPoints(path, raw)
    record = laz_record(path, raw)
    if not is_chunked(record):
        return LazStream(path, raw, record, None)
    if raw.is_copc:
        nodes = read_octree(stream, path, raw, metres_per_unit)
        if not has_huge_chunks(nodes, raw):
            return LazChunks(path, raw, record, nodes)
    table = read_table(stream, path, raw, record)
    source = LazStream if has_huge_chunks(table, raw) else LazChunks
    return source(path, raw, record, table)


def _layout(raw: RawHeader) -> RecordLayout:
    """Return where the fields are: LAS 1.4 R15, tables 7 and 10; formats 6 and up have a separate class byte.

    A point source id of 0 stands for that of the file.
    """
    layered = raw.point_format >= 6
    return RecordLayout(
        raw.scales,
        raw.offsets,
        class_byte=16 if layered else 15,
        class_mask=255 if layered else 31,
        withheld_byte=15,
        withheld_mask=4 if layered else 128,
        line_byte=20 if layered else 18,
        line=raw.source_id,
    )


def _refuse_scales(path: Location, raw: RawHeader) -> None:
    for name, values in (("scale", raw.scales), ("offset", raw.offsets)):
        if not np.isfinite(values).all() or (name == "scale" and 0 in values):
            shown = ", ".join(f"{value:g}" for value in values)
            raise BadInputError(
                f"the header of {path} gives the {name} of x, y and z as {shown}; it must be a finite number"
                f"{' other than 0' if name == 'scale' else ''}. The file is damaged; export it again"
            )


def _middle(raw: RawHeader) -> tuple[float, float, float] | None:
    x, y, z = (first / 2 + last / 2 for first, last in zip(raw.mins, raw.maxs, strict=True))
    return (x, y, z) if np.isfinite([x, y, z]).all() else None


def _bounds(raw: RawHeader, place: Georeference) -> Bounds:
    # Overflow becomes infinity, which is rejected later, as is NaN.
    with np.errstate(over="ignore", invalid="ignore"):
        sides = np.round(np.array([*raw.mins[:2], *raw.maxs[:2]]), DECIMALS) * place.metres_per_unit
    return Bounds(*sides.tolist())


def _degrees_note(place: Georeference, raw: RawHeader) -> tuple[str, ...]:
    """Return a note if a file without CRS may be in degrees: scale below 1e-6, extent within 180 x 90."""
    inside = max(map(abs, (raw.mins[0], raw.maxs[0]))) <= 180 and max(map(abs, (raw.mins[1], raw.maxs[1]))) <= 90
    if place.crs is not None or not inside or max(raw.scales[:2]) > 1e-6:
        return ()
    return (
        "its coordinates look like degrees; if they are, pass `crs='EPSG:4326'` for the command that reprojects it",
    )
