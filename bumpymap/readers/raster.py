"""The reader of rasters of heights, DSM or DTM, as GeoTIFF: the middle of each pixel that has a height is a point."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from bumpymap.core import (
    BadInputError,
    Place,
    block_bytes,
    closed_gdal,
    georeference,
    open_tiff,
    raster_statement,
)
from bumpymap.readers.point_stats import PointStats, verify
from bumpymap.readers.protocol import (
    CHUNK_POINTS,
    Chunk,
    ChunkPoints,
    ReadOptions,
    SurveyInfo,
    SurveyReader,
    chunk_capacity,
)
from bumpymap.readers.source import Location, decoding, require_unchanged, size_of
from bumpytiles import Bounds, ScaledPoints, Scaling

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

COARSEST_M = 1.0
"""Largest pixel that is read, m: a tile of 3 m then has 9 points, and a thin one is rated from 4 on."""
_MOST_PIXELS, _SMALL, _DENSEST = 100_000_000_000, 100_000_000, 4096
"""Pixels of a raster at most, as of heightmap.tif; pixels up to which a raster may hold next to nothing; and pixels per
byte at most of a larger one, as of points in LAZ."""
_CACHE = 32 << 20
"""Decoded blocks that GDAL keeps, bytes, if two fit into it."""
_HIGHEST_M = 9_000.0
"""Heights farther from zero are no ground, but nodata that the file does not declare (-9999, -32767, 3.4e38)."""
_FINE_PIXEL_M = 0.25
"""Side of a pixel, m, from which on a note is made: C_r of pixels of 20 cm is that of points within 15 %, measured."""
_STEP = 1e-4
"""Step of heights, in the unit of the file: a tenth of a millimetre."""
_COARSE_HEIGHT_M = 0.1
"""Steps between heights of whole numbers from which on a note is made, m."""
_MOST_SEEN = 100.0
"""Pixels per m2 of which more show nothing more. Chosen, a dense cloud of photos: of the pixels of 5 cm made of one
with 98 points per m2, 78 % are interpolated."""
_UNCLASSIFIED = 1
"""LAS class of points that nobody has classified."""
_KINDS = ("float32", "float64", "int16", "uint16", "int32", "uint32")
"""Types of heights."""
_PIXEL_BYTES = 40
"""Memory of a pixel while it is converted."""
_UNITS = {"m": 1.0, "metre": 1.0, "meter": 1.0, "metres": 1.0, "meters": 1.0, "ft": 0.3048, "foot": 0.3048}
_UNITS |= {"feet": 0.3048, "us survey foot": 1200 / 3937, "us-ft": 1200 / 3937, "ftus": 1200 / 3937}
"""Units of a band as GDAL's writers spell them, in lower case, in m."""
_WRITE_AGAIN = "Write it again with: gdal_translate -co TILED=YES -co COMPRESS=DEFLATE IN.tif OUT.tif"
_CANNOT_TELL = {
    False: "a DSM has one height for each pixel, often smoothed: what lies under trees, roofs and wires is not in it, "
    "edges are blurred, and its noise is not known",
    True: "a DTM is of the ground alone: obstacles are not in it, so none bars a tile",
}
"""Notes on a DSM and on a DTM."""


class RasterSurvey(SurveyReader):
    """A raster of heights: one band of numbers, rows from west to east, in a projected CRS, with pixels of 1 m at most.

    Heights are rounded to a tenth of a millimetre, so that a point takes no more memory than one of LAS. Pixels without
    a height are dropped points.
    """

    def _open(self, options: ReadOptions) -> SurveyInfo:
        path, size = self._path, size_of(self._path)
        with closed_gdal(), decoding(path, "the header"):
            self._file = file = open_tiff(path, _WRITE_AGAIN)
            statement = replace(raster_statement(file), metres_per_unit_z=_UNITS.get((file.units[0] or "").lower()))
            _refuse_picture(path, file)
            kind = np.dtype(file.dtypes[0])
            self._height, self._block = (file.scales[0], file.offsets[0]), file.block_shapes[0]
            # A block that is cut into chunks is decoded once.
            self._cache = max(_CACHE, 2 * block_bytes(file))
            self._shape, sides = (file.height, file.width), tuple(file.transform)[:6]
        _refuse_size(path, math.prod(self._shape), size)
        x_step, y_step, west, north = _north_up(path, sides)
        rows, cols = self._shape
        middle = (west + x_step * cols / 2, north + y_step * rows / 2, 0.0)
        place, notes = georeference(Place(path, middle), statement, options)
        units = (place.metres_per_unit, place.metres_per_unit, place.metres_per_unit_z)
        scales, origin = (x_step, y_step, _STEP), (west + x_step / 2, north + y_step / 2, 0.0)
        self._scaling = Scaling(scales, origin, units)
        pixel, step = max(abs(x_step), abs(y_step)) * units[0], abs(self._height[0]) * units[2]
        if pixel > COARSEST_M * (1.0 + 1e-6):
            raise BadInputError(
                f"the pixels of {path} are {pixel:g} m wide, and at most {COARSEST_M:g} m are read: roughness that a "
                "vehicle feels is finer. Export the model with pixels of 5 to 20 cm, or give the point cloud"
            )
        if pixel > _FINE_PIXEL_M:
            why = "at 0.5 m most passable tiles are lost, and C_r is half to twice that"
            notes += (f"its pixels are coarse ({pixel:g} m): {why}",)
        if kind.kind in "iu" and step >= _COARSE_HEIGHT_M:
            notes += (f"its heights lie on steps of {step:g} m: fine relief is lost",)
        self._kind = options.kinds[options.ground_classes[0] if options.dtm else _UNCLASSIFIED]
        ends = [self._scaling.coordinates(axis, np.array([0, side - 1])) for axis, side in enumerate((cols, rows))]
        (west, east), (south, north) = (sorted(end.tolist()) for end in ends)
        what = f"GeoTIFF ({'DTM' if options.dtm else 'DSM'}), {kind}, pixels of {pixel:g} m"
        bounds, notes = Bounds(west, south, east, north), (*notes, _CANNOT_TELL[options.dtm])
        return SurveyInfo(path, what, size, rows * cols, place, bounds, options.dtm, notes, most_seen=_MOST_SEEN)

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Split into windows of whole blocks of the file, or into parts of its blocks if these are larger."""
        step, (high, wide) = chunk_capacity(points, _PIXEL_BYTES), self._block
        height, width = self._shape
        rows, cols = high, max(step // (high * wide), 1) * wide
        if high * wide > step:
            rows, cols = max(step // wide, 1), min(wide, step)
        elif cols >= width:
            rows, cols = max(step // (high * width), 1) * high, width
        chunks: list[Chunk] = []
        first, band = 0, max(rows, high)
        for top, left in product(range(0, height, band), range(0, width, cols)):
            end, across = min(top + band, height), min(cols, width - left)
            for row in range(top, end, rows):
                down = min(rows, end - row)
                chunks.append(Chunk(len(chunks), first, down * across, (left, row, across, down)))
                first += down * across
        return chunks

    def _fetch(self, chunk: Chunk) -> Any:
        """Return the numbers of a window, masked where it has none."""
        from rasterio.windows import Window

        col, row, cols, rows = chunk.window
        with closed_gdal(GDAL_CACHEMAX=self._cache), decoding(self._path, "the heights"):
            return self._file.read(1, window=Window(col, row, cols, rows), masked=True)

    def _convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        scale, offset = self._height
        scaling = self._scaling
        with np.errstate(over="ignore", invalid="ignore"):  # NaN, or beyond all heights: no height
            heights = np.ma.getdata(fetched).astype(np.float64)
            if (scale, offset) != (1.0, 0.0):
                heights = heights * scale + offset
            known = (np.abs(heights) * scaling.units[2] <= _HIGHEST_M) & ~np.ma.getmaskarray(fetched)
        row, col = (place.astype(np.int32) for place in np.nonzero(known))
        upward = np.rint(heights[known] / _STEP).astype(np.int32)
        row, col = row + np.int32(chunk.window[1]), col + np.int32(chunk.window[0])
        stats = PointStats(chunk.points, not_a_number=chunk.points)
        if upward.size:
            ends = [sorted(scaling.coordinates(n, [of.min(), of.max()])) for n, of in enumerate((col, row, upward))]
            stats = PointStats.within(ends, chunk.points, not_a_number=chunk.points - upward.size)
        kind = np.full(upward.size, self._kind, np.uint8)
        return ChunkPoints(ScaledPoints(col, row, upward, kind, scaling), stats)

    def verify(self, stats: PointStats) -> None:
        """Check as other readers do, but for the extent: pixels cannot lie outside it, and most may have no height."""
        require_unchanged(self._path, self._version)
        verify(stats, self._path, self._info.point_count, None)


def _refuse_picture(path: Location, file: "DatasetReader") -> None:
    """Raise BadInputError unless a raster has one band of numbers that may be heights, with or without a mask."""
    kinds = file.dtypes
    if len(kinds) - (len(kinds) > 1 and file.colorinterp[-1].name == "alpha") > 1 or kinds[0] not in _KINDS:
        raise BadInputError(
            f"{path} is no raster of heights: it has {len(kinds)} band{'s' * (len(kinds) > 1)} of {kinds[0]}, as a "
            f"picture or a hillshade has. Heights are one band of {', '.join(_KINDS)}; an orthophoto is given as "
            "`photo`, beside a DSM or a point cloud"
        )


def _refuse_size(path: Location, pixels: int, size: int) -> None:
    """Raise BadInputError if a raster declares more pixels than one map holds, or than its bytes can mean."""
    if pixels > _MOST_PIXELS or pixels > max(_SMALL, _DENSEST * size):
        raise BadInputError(
            f"{path} declares {pixels:,} pixels in {size:,} bytes: at most {_MOST_PIXELS:,} are read, and {_DENSEST:,} "
            f"for each byte of a raster of more than {_SMALL:,}. Is it damaged, or nearly empty? Cut it out with: "
            "gdalwarp -crop_to_cutline -cutline SITE.geojson IN.tif OUT.tif"
        )


def _north_up(path: Location, sides: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Return the sides of a pixel, x and y, and the corner of the first, from an affine transform."""
    x_step, x_turn, west, y_turn, y_step, north = sides
    if sides == (1.0, 0.0, 0.0, 0.0, 1.0, 0.0):
        raise BadInputError(
            f"{path} does not say where it lies, or a file beside it does, which is not read. Write it into the file "
            f"with: gdal_translate -a_srs EPSG:CODE {path} OUT.tif"
        )
    if x_turn or y_turn:
        raise BadInputError(
            f"{path} is rotated: its rows do not run from west to east. Turn it with: gdalwarp {path} OUT.tif"
        )
    if not (x_step and y_step and np.isfinite(sides).all()):
        raise BadInputError(f"{path} has pixels of {x_step:g} x {y_step:g}, which is impossible. Export it again")
    return x_step, y_step, west, north
