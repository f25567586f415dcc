"""LAS, LAZ and COPC through laspy, decoded by lazrs in parallel, only the fields that bumpymap needs."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from laspy import DecompressionSelection, LazBackend
from numpy.typing import NDArray

from bumpymap.crs import CrsStatement, Place, georeference
from bumpymap.errors import BadInputError
from bumpymap.readers.base import Survey
from bumpymap.readers.checks import RawPoints, decoding, refuse_header_bounds
from bumpymap.readers.columns import DECIMALS
from bumpymap.readers.geokeys import statement_of_las
from bumpymap.readers.las_header import RawHeader, geokeys_of, read_raw_header, text_of
from bumpymap.readers.laz_table import check_laz
from bumpymap.readers.protocol import ReadOptions, SurveyInfo
from bumpymap.types import Georeference
from bumpytiles import Bounds

__all__ = ["LasSurvey"]

# What laspy logs as an error it raises too, or it shows in the number of points.
logging.getLogger("laspy").setLevel(logging.CRITICAL)

_FIELDS = DecompressionSelection.base().decompress_z().decompress_classification().decompress_flags()
_BACKENDS = (LazBackend.LazrsParallel, LazBackend.Lazrs)
_PROJECTION = b"LASF_Projection"


class LasSurvey(Survey):
    """One LAS, LAZ or COPC file.

    A coordinate is ``integer * scale + offset``, rounded to 1e-8 of the file's unit, then turned into metres. The
    rounding takes off the last bits of the float sum, which depend on the offset that a writer chose: a survey split
    into files with other offsets then gives the same bits. 1e-8 is far below a LAS grid (1e-3 or so) and above the
    spacing of float64 up to 6.7e7 units, so millimetres at 4,000,000 m stay what they are.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with decoding(path, "the header"), path.open("rb") as stream:
            raw = read_raw_header(stream, path)
            if raw.compressed:
                check_laz(stream, path, raw)
            stream.seek(0)
            header = laspy.LasReader(stream, closefd=False, read_evlrs=False).header
            size = path.stat().st_size
        _refuse_scales(path, header.scales, header.offsets)
        middle = _middle(header.mins, header.maxs)
        place, notes = georeference(Place(path, middle), _statement(raw), options.crs, options.z_unit)
        bounds = None if options.trust_points else _bounds(header.mins, header.maxs, place)
        if bounds is not None:
            refuse_header_bounds(path, bounds)
        kind = f"{'LAZ' if raw.compressed else 'LAS'} {raw.version}, point format {raw.point_format}"
        super().__init__(
            SurveyInfo(
                path,
                f"COPC ({kind})" if raw.is_copc else kind,
                size,
                raw.point_count,
                place,
                bounds,
                has_classes=None,
                notes=notes + _degrees_note(place, header.scales, header.mins, header.maxs),
            )
        )

    def raw(self, points: int) -> Iterator[RawPoints]:
        """Give every point, at most ``points`` at a time."""
        path = self.info.path
        with path.open("rb") as stream:
            with decoding(path, "the header"):
                reader = laspy.LasReader(
                    stream, closefd=False, laz_backend=_BACKENDS, read_evlrs=False, decompression_selection=_FIELDS
                )
            while True:
                with decoding(path, f"points from {reader.points_read:,} on"):
                    chunk = reader.read_points(points)
                if len(chunk) == 0:
                    return
                yield self._metres(chunk)

    def _metres(self, chunk: Any) -> RawPoints:
        unit = self.info.georeference
        units = (unit.metres_per_unit, unit.metres_per_unit, unit.metres_per_unit_z)
        x, y, z = (
            _coordinate(chunk.array[name], chunk.scales[axis], chunk.offsets[axis], units[axis])
            for axis, name in enumerate("XYZ")
        )
        return RawPoints(x, y, z, np.asarray(chunk.classification), np.asarray(chunk.withheld).astype(np.bool_))


def _coordinate(integer: NDArray[np.int32], scale: float, offset: float, unit: float) -> NDArray[np.float64]:
    # What overflows becomes infinite, and is refused for it.
    with np.errstate(over="ignore", invalid="ignore"):
        value: NDArray[np.float64] = integer * np.float64(scale)
        value += offset
        np.round(value, DECIMALS, out=value)
        if unit != 1.0:
            value *= unit
    return value


def _statement(header: RawHeader) -> CrsStatement:
    wkt = text_of(header.find(_PROJECTION, 2112))
    keys = geokeys_of(header.find(_PROJECTION, 34735))
    citation = text_of(header.find(_PROJECTION, 34737)).split("|")[0]
    return statement_of_las(wkt or None, keys, citation, wkt_bit=header.wkt_bit)


def _refuse_scales(path: Path, scales: NDArray[np.float64], offsets: NDArray[np.float64]) -> None:
    for name, values in (("scale", scales), ("offset", offsets)):
        if not np.isfinite(values).all() or (name == "scale" and (values == 0).any()):
            shown = ", ".join(f"{value:g}" for value in values)
            raise BadInputError(
                f"the header of {path} gives the {name} of x, y and z as {shown}; it must be a finite number"
                f"{' other than 0' if name == 'scale' else ''}. The file is damaged; export it again"
            )


def _middle(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[float, float, float] | None:
    middle = [float(value) for value in low / 2 + high / 2]
    return (middle[0], middle[1], middle[2]) if np.isfinite(middle).all() else None


def _bounds(low: NDArray[np.float64], high: NDArray[np.float64], place: Georeference) -> Bounds:
    west, south, east, north = (
        float(np.round(value, DECIMALS) * place.metres_per_unit) for value in (low[0], low[1], high[0], high[1])
    )
    return Bounds(west, south, east, north)


def _degrees_note(
    place: Georeference, scales: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[str, ...]:
    """Say so where a file without CRS looks like degrees: a grid finer than a micrometre, inside 180 x 90."""
    inside = np.abs([low[0], high[0]]).max() <= 180 and np.abs([low[1], high[1]]).max() <= 90
    if place.crs is not None or not inside or scales[:2].max() > 1e-6:
        return ()
    return ("its coordinates look like degrees; if they are, pass --crs EPSG:4326 for the command that reprojects it",)
