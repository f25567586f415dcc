"""Write the cost map as regions: cost.geojson in WGS 84, cost.fgb in the survey's CRS.

Both take some thousand regions at a time, so that memory does not grow with the map.

*Regions* are adjacent tiles of one class with the mean values of their tiles. A region is either passable as a whole,
and then lies in one zone, or not at all. scikit-image numbers the areas, because scipy.ndimage labels one value at a
time. Sums are made one tile after the other: the same tiles in the same order give the same bits.

Rings have a vertex wherever the ring of a neighbour has one. Outlines of adjacent areas are then a valid coverage in
any coordinates: both sides of a border are the same segments, however they are bent or rounded on the way.
"""

import itertools
import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import rasterio.features
import shapely
import shapely.geometry
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError
from rasterio.transform import Affine

from bumpymap.core import CLASS_NAMES, FAIL_SHARE, NO_CLASS, REASON_TEXT, BadInputError, CostTable, atomic, raster_lock
from bumpymap.layers.placement import Placement, RasterWindow
from bumpytiles import BLOCK_TILES, TileWindow


def label(keys: NDArray[np.integer]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Give a number to each of the 4-connected areas of equal key, from 1, in the order of their first pixels.

    ``keys`` (rows, cols) integers: 0 belongs to no area. Returns ``labels`` (rows, cols) int32: number of the area of
    each pixel; 0 where the key is 0; ``first`` (m,) int64: first pixel of each area, as a position in ``keys.ravel()``.
    """
    from skimage.measure import label as number_areas

    labels = number_areas(keys, background=0, connectivity=1).astype(np.int32)
    first = np.empty(int(labels.max(initial=0)) + 1, np.int64)
    first[labels.ravel()[::-1]] = np.arange(labels.size - 1, -1, -1)  # of equal indices the last assignment counts
    return labels, first[1:]


def shared_corners(areas: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Find the corners of tiles that are vertices of outlines: all at which borders turn, meet, cross or touch.

    ``areas`` integers (rows + 2, cols + 2): number of the area of each tile of a window and of the tiles around it,
    north row first; 0 for none. There is a border between tiles that share a side and have unlike numbers. Returns bool
    (rows + 1, cols + 1): one for each corner of a tile of the window, north-west first. False on straight borders and
    off them.
    """
    beside = areas[:, 1:] != areas[:, :-1]
    below = areas[1:] != areas[:-1]
    corners: NDArray[np.bool_] = (beside[1:] | beside[:-1]) & (below[:, 1:] | below[:, :-1])
    return corners


def trace_labels(
    labels: NDArray[np.int32], window: TileWindow, rows: slice, wanted: range, corners: NDArray[np.bool_] | None = None
) -> NDArray[np.object_]:
    """Trace the outlines of 4-connected areas of tiles: right-hand rings, in grid coordinates (1 is one tile).

    ``labels`` int32 (rows, cols): number of the area of each tile of the window, north row first; ``rows``: rows of
    the window in which the wanted areas lie; ``wanted``: their numbers; ``corners`` bool (rows + 1, cols + 1):
    corners of tiles of the window that are vertices, from `shared_corners`: at least those at which the border of a
    wanted area turns. By default those of ``labels`` alone. Returns (len(wanted),) polygons.
    """
    part = labels[rows]
    held = shared_corners(np.pad(part, 1)) if corners is None else corners[rows.start : rows.start + len(part) + 1]
    mask = (part >= wanted.start) & (part < wanted.stop)
    order, holes, rings = [], [], []
    with raster_lock():  # a raster in memory, whose blocks share the cache with those that other threads write
        shapes = list(rasterio.features.shapes(part, mask=mask, connectivity=4, transform=Affine.identity()))
    for shape, number in shapes:
        order.append(int(number) - wanted.start)
        holes.append(len(shape["coordinates"]))
        rings += shape["coordinates"]
    # In one call: one call per ring takes three times as long.
    turns = np.array(list(itertools.chain.from_iterable(rings))).astype(np.int64)
    points, sizes = _follow(turns, np.array([len(ring) for ring in rings]), held)
    placed = np.array([window.col, window.row + window.rows - rows.start]) + points * np.array([1.0, -1.0])
    lines = shapely.linearrings(placed, indices=np.repeat(np.arange(len(rings)), sizes))
    traced = np.empty(len(wanted), dtype=object)
    traced[order] = shapely.polygons(lines, indices=np.repeat(np.arange(len(holes)), holes))
    # GEOS normalises exterior rings to clockwise order with a fixed first vertex; reversed, they follow RFC 7946.
    outlines: NDArray[np.object_] = shapely.reverse(shapely.normalize(traced))
    return outlines


def _follow(
    points: NDArray[np.int64], sizes: NDArray[np.int64], corners: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Follow closed rings along the sides of tiles and stop at each corner that is marked.

    ``points`` (n, 2) are column and line of the vertices of all rings, ``sizes`` (m,) of them in each, as in what is
    returned; ``corners`` (lines, columns) holds every point at which a ring turns.
    """
    lines, columns = corners.shape
    # The marked corners twice, line by line and column by column: those of a segment follow each other in one of both.
    marked = np.concatenate([np.flatnonzero(corners), np.flatnonzero(corners.T) + corners.size]).astype(np.int32)
    ends = np.cumsum(sizes)
    start = np.delete(points, ends - 1, axis=0)
    stop = np.delete(points, ends - sizes, axis=0)
    upright = start[:, 0] == stop[:, 0]
    first, last = (
        np.where(upright, corners.size + at[:, 0] * lines + at[:, 1], at[:, 1] * columns + at[:, 0]).astype(np.int32)
        for at in (start, stop)
    )
    first, last = (np.searchsorted(marked, at) for at in (first, last))
    count = np.abs(last - first)
    before = np.cumsum(count) - count
    step = np.sign(last - first)
    found = marked[np.repeat(first - step * before, count) + np.repeat(step, count) * np.arange(count.sum())]
    upright = np.repeat(upright, count)
    found = found - corners.size * upright
    met = np.where(upright, [found // lines, found % lines], [found % columns, found // columns]).T
    held = np.add.reduceat(count, ends - sizes - np.arange(len(sizes)))
    ends = np.cumsum(held)
    return np.insert(met, ends, met[ends - held], axis=0), held + 1


REGION_WINDOW = 2_048
"""Side of the windows at whose borders regions are cut, tiles: 6 km of 3 m tiles."""
BATCH = 8_192
"""Most regions at a time: some tens of megabytes of outlines even if every tile is a region of its own."""
_STRIP = REGION_WINDOW * BLOCK_TILES
"""Most tiles to read at a time: one row of blocks, so that sums run along the rows of a window."""
_VALUES = ("c_r", "c_r_low", "c_r_high", "p_fail")

_IMPASSABLE, _UNKNOWN, _OTHER_WINDOW, _ZONE = 10, 100, 128, 256
"""Parts of the keys of tiles, of which those with equal ones join. 0: no points; class + 1: passable; with the first
added: not passable; the second plus the reason: no class; the third is added outside a window, so that the cut is a
border; the last times the zone is added to passable ones."""


@dataclass(frozen=True, slots=True)
class Regions:
    """Regions of a map, one row each."""

    placement: Placement
    number: NDArray[np.int64]
    """(m,) number of the region in the map, from 1, without gaps."""
    outlines: NDArray[np.object_]
    """(m,) polygons in grid coordinates: 1 is one tile, 0 the origin of the CRS. A corner of a region is a vertex of
    all regions that it touches."""
    class_id: NDArray[np.uint8]
    """(m,) class; ``NO_CLASS`` where unknown."""
    reason: NDArray[np.uint8]
    """(m,) a ``Reason``."""
    tiles: NDArray[np.int64]
    """(m,) number of tiles."""
    passable: NDArray[np.bool_]
    """(m,) True: every tile is passable; False: none is."""
    zone: NDArray[np.int32]
    """(m,) the zone of all tiles, from 1; 0 where not passable, or part of none."""
    c_r: NDArray[np.float64]
    """(m,) mean over the tiles, rad/m; NaN where unknown (as in the next three)."""
    c_r_low: NDArray[np.float64]
    c_r_high: NDArray[np.float64]
    p_fail: NDArray[np.float64]
    hazard: NDArray[np.float64]
    """(m,) mean over the tiles, 1/m; NaN where not passable, or if the rating has no ``p_fail``."""
    cost: NDArray[np.float64]
    """(m,) factor on distance, mean over the tiles; NaN where not passable."""


def dissolve(table: CostTable) -> Iterator[Regions]:
    """Dissolve tiles that share a side into regions: of one class and, if passable, zone, or of one reason if unknown.

    Outlines run along tile sides; vertices are whole numbers of tiles. All of them are a valid coverage: adjacent
    regions have the same vertices along their border. A large map is dissolved in windows of `REGION_WINDOW` x
    `REGION_WINDOW` tiles from its north-west corner: regions are cut at the borders of windows, and memory does not
    depend on the size of the map. Yields up to some thousand regions: windows north-west first, regions of a window in
    the order of their first tile, northmost (then westmost) first. They are numbered in that order. Raises
    BadInputError: the extent is too large for a raster.
    """
    place = Placement.of(table)
    found = 0
    for window in place.windows(REGION_WINDOW, aligned=False):
        if table.tiles.holds(window.tiles):
            for regions in _dissolve_window(table, place, window, found):
                found += len(regions.number)
                yield regions


def _dissolve_window(table: CostTable, place: Placement, window: RasterWindow, before: int) -> Iterator[Regions]:
    """Yield the regions of a window; ``before`` are those of the windows before it."""
    keys = _region_keys(table, window)
    corners = shared_corners(keys)
    keys = np.ascontiguousarray(keys[1:-1, 1:-1])
    labels, first = label(keys)
    last_row = np.empty(len(first) + 1, np.int64)
    last_row[labels] = np.arange(len(labels))[:, None]
    last_row = last_row[1:]
    zone, key = np.divmod(keys.ravel()[first], _ZONE)
    tiles = np.bincount(labels.ravel(), minlength=len(first) + 1)[1:]
    means = _sum_values(table, window, labels, len(first)) / tiles
    passable = key < _IMPASSABLE
    class_id = np.where(key >= _UNKNOWN, NO_CLASS, (key - 1) % _IMPASSABLE).astype(np.uint8)
    reason = np.where(key >= _UNKNOWN, key - _UNKNOWN, 0).astype(np.uint8)
    for start in range(0, len(first), BATCH):
        some = slice(start, start + BATCH)
        numbers = range(start + 1, start + len(first[some]) + 1)
        rows = slice(int(first[start]) // window.tiles.cols, int(last_row[some].max()) + 1)
        c_r, c_r_low, c_r_high, p_fail, hazard = means[:, some]
        free = passable[some]
        yield Regions(
            placement=place,
            number=np.arange(before + numbers.start, before + numbers.stop),
            outlines=trace_labels(labels, window.tiles, rows, numbers, corners),
            class_id=class_id[some],
            reason=reason[some],
            tiles=tiles[some],
            passable=free,
            zone=zone[some].astype(np.int32),
            c_r=c_r,
            c_r_low=c_r_low,
            c_r_high=c_r_high,
            p_fail=p_fail,
            hazard=np.where(free, hazard, np.nan),
            cost=np.where(free, table.rule.cost(c_r, hazard), np.nan),
        )


def _region_keys(table: CostTable, window: RasterWindow) -> NDArray[np.int64]:
    """Return the keys (rows + 2, cols + 2) of a window and of the tiles around it, north row first; 0: no tile."""
    around = window.tiles.grown(1)
    keys = np.zeros((around.rows, around.cols), dtype=np.int64)
    for strip in table.tiles.strips(_STRIP, around):
        found = table.tiles.read(("class_id", "barred", "reason", "zone"), strip)
        part = np.where(found["barred"] == 0, found["zone"].astype(np.int64) * _ZONE, _IMPASSABLE)
        known = part + found["class_id"] + 1
        key = np.where(found["class_id"] == NO_CLASS, _UNKNOWN + found["reason"], known)
        keys[around.cells(found["col"], found["row"])] = key
    for edge in (keys[0], keys[-1], keys[1:-1, 0], keys[1:-1, -1]):
        edge[edge > 0] += _OTHER_WINDOW
    return keys


def _sum_values(table: CostTable, window: RasterWindow, labels: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    """Return the sums (5, count) of ``_VALUES`` and of the hazard over the tiles of each label.

    Columns are read a second time here because that takes less memory than keeping them.
    """
    totals = np.zeros((len(_VALUES) + 1, count))
    for strip in table.tiles.strips(_STRIP, window.tiles):
        found = table.tiles.read(_VALUES, strip)
        area = labels[window.tiles.cells(found["col"], found["row"])] - 1
        values = [*(found[name] for name in _VALUES), table.rule.hazard(found["p_fail"]).astype(np.float32)]
        for total, own in zip(totals, values, strict=True):
            np.add.at(total, area, own.astype(np.float64))
    return totals


_TRIES = 33
"""Points along each side of the raster at which the transformation is tried first: chosen."""
_SEGMENT = 32
"""Longest straight segment of an outline, tiles. In longitude and latitude, the middle of a 96 m segment is off by at
most 1.2 mm (measured up to 80 degrees north and south): less than the 7 decimals that are kept."""
_GRID_DECIMALS = 9
"""Of tiles: far below what a file keeps, far above the error of a double."""
DEGREE_DECIMALS, _METRE_DECIMALS = 7, 3
"""Of longitude and latitude, 1 cm, and of the survey's own coordinates, 1 mm: chosen."""


def wgs84_transformer(placement: Placement) -> Transformer:
    """Return the transformer from the survey's CRS to WGS 84 longitude and latitude, tried on points of the raster.

    Raises BadInputError: there is no CRS, or no known transformation from it to longitude and latitude at this place;
    or it lies across the antimeridian.
    """
    crs, window = placement.horizontal_crs, placement.window
    if crs is None:
        raise BadInputError(
            "the survey has no CRS, so cost.geojson cannot say where on Earth it is. Pass `crs='EPSG:CODE'`, "
            "or `local=True` to write it in the survey's own coordinates"
        )
    try:
        transformer = Transformer.from_crs(crs, CRS.from_epsg(4326), always_xy=True)
    except ProjError as error:
        raise BadInputError(
            f"the survey's CRS ({crs.name}) has no known relation to longitude and latitude, so cost.geojson cannot "
            "say where on Earth it is. Pass another with `force_crs='EPSG:CODE'`, or `local=True` to keep its own "
            "coordinates"
        ) from error
    cols, rows = np.meshgrid(
        np.linspace(window.col, window.col + window.cols, _TRIES),
        np.linspace(window.row, window.row + window.rows, _TRIES),
    )
    degrees = transformer.transform(placement.to_crs(cols.ravel()), placement.to_crs(rows.ravel()))
    if not np.isfinite(degrees).all():
        raise _outside(placement)
    if np.ptp(degrees[0]) > 180.0:
        raise BadInputError(
            "the survey lies on both sides of the antimeridian, where longitudes jump from 180 to -180 degrees. Pass "
            "`local=True` to write cost.geojson in the survey's own coordinates"
        )
    return transformer


def _outside(placement: Placement) -> BadInputError:
    return BadInputError(
        f"the survey's coordinates lie outside the area where its CRS ({placement.horizontal_crs}) can be converted to "
        "longitude and latitude. Pass the right one with `force_crs='EPSG:CODE'`, or `local=True`"
    )


_LOCAL = (
    "x and y are the survey's own coordinates, not longitude and latitude: its place on Earth is not "
    "known. This file is therefore not RFC 7946 GeoJSON"
)
_NO_CRS = (
    'ENGCRS["survey without a CRS",EDATUM["unknown"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],'
    'LENGTHUNIT["unit of the survey",{}]]'
)
_KINDS = {"region": "int64", "class": "int32", "zone": "int32", "tiles": "int64", "passable": "bool"}
_KINDS |= dict.fromkeys(("class_name", "reason", "c_r_basis"), "string")
"""Types of columns of cost.fgb; the others are float64."""
_PROPERTIES = (
    *("region", "class", "class_name", "reason", "passable", "zone", "c_r", "c_r_low", "c_r_high", "c_r_basis"),
    *("p_fail", "hazard", "cost", "area_m2", "tiles"),
)
_GEOMETRY = "geometry"
IN_MEMORY = 16 << 20
"""Most bytes of regions that are converted to FlatGeobuf in memory: chosen."""


@dataclass(frozen=True, slots=True)
class GeoJsonCoordinates:
    """The coordinates of cost.geojson: WGS 84 longitude and latitude, or the survey's own."""

    placement: Placement
    to_degrees: Transformer | None
    """Transformer to longitude and latitude; None: keep the survey's own coordinates."""

    @classmethod
    def of(cls, placement: Placement, *, local: bool) -> "GeoJsonCoordinates":
        """Choose longitude and latitude if possible, else the survey's own coordinates if ``local``.

        Raises BadInputError: the survey has no CRS, or one that cannot be transformed, and ``local`` is False.
        """
        try:
            return cls(placement, wgs84_transformer(placement))
        except BadInputError:
            if not local:
                raise
            return cls(placement, None)

    @property
    def members(self) -> dict[str, Any]:
        """Members of the feature collection that declare local coordinates; none for longitude and latitude.

        Without the member ``crs`` of GeoJSON before RFC 7946, GDAL takes every GeoJSON file for WGS 84, one whose
        ``crs`` is null too, and QGIS shows a survey off the coast of Africa, at 0, 0.
        """
        if self.to_degrees is not None:
            return {}
        crs, scale = self.placement.horizontal_crs, self.placement.georeference.metres_per_unit
        name = _NO_CRS.format(scale) if crs is None else crs.to_wkt()
        declared = {"crs": {"type": "name", "properties": {"name": name}}}
        return {"local_coordinates": _LOCAL, "metres_per_unit": scale, **declared}

    def polygons(self, polygons: NDArray[np.object_]) -> NDArray[np.object_]:
        """Convert polygons (m,) in grid coordinates (1 = one tile), with sides along the sides of tiles, to these.

        Own coordinates are rounded to 1 mm, degrees to 1 cm; rings stay right-hand. Polygons with the same vertices
        along their common borders keep this property. Raises BadInputError: a point cannot be transformed to longitude
        and latitude.
        """
        place, to_degrees = self.placement, self.to_degrees
        if to_degrees is None:
            own: NDArray[np.object_] = shapely.transform(
                polygons, lambda points: place.to_crs(points).round(_METRE_DECIMALS)
            )
            return own

        def move(points: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.column_stack(to_degrees.transform(points[:, 0], points[:, 1])).round(DEGREE_DECIMALS)

        # The points in between are rounded because those of a side in one direction and the other differ in the last
        # bit.
        split = shapely.segmentize(polygons, _SEGMENT)
        placed = shapely.transform(split, lambda points: place.to_crs(points.round(_GRID_DECIMALS)))
        outlines: NDArray[np.object_] = shapely.transform(placed, move)
        if not np.isfinite(shapely.bounds(outlines)).all():
            raise _outside(place)
        return outlines

    @property
    def has_degrees(self) -> bool:
        """True if these are longitude and latitude."""
        return self.to_degrees is not None

    def in_crs(self, grid_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert (n, 2) easting and northing on the grid, m, to units of the survey's CRS."""
        return np.asarray(grid_m / self.placement.georeference.metres_per_unit, dtype=np.float64)

    def in_file(self, grid_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert points (n, 2) on the grid, m, to these; own coordinates are rounded to 1 mm, degrees to 1 cm.

        Raises BadInputError: a point cannot be transformed to longitude and latitude.
        """
        own = self.in_crs(grid_m)
        if self.to_degrees is None:
            return own.round(_METRE_DECIMALS)
        degrees = np.column_stack(self.to_degrees.transform(own[:, 0], own[:, 1])).round(DEGREE_DECIMALS)
        if not np.isfinite(degrees).all():
            raise BadInputError(
                f"a position lies outside the area where the survey's CRS ({self.placement.horizontal_crs}) can be "
                "converted to longitude and latitude. Map the survey again with the right one, `force_crs='EPSG:CODE'`"
            )
        return degrees


def outline_of(geometry: Mapping[str, Any]) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Return the corners of a polygon of GeoJSON, (n, 2), and a point in it."""
    polygon = shapely.geometry.shape(geometry)
    inside = polygon.representative_point()
    return shapely.get_coordinates(polygon), (float(inside.x), float(inside.y))


def feature(
    properties: Mapping[str, Any], geometry: shapely.Geometry | None, number: int | None = None
) -> dict[str, Any]:
    """Return a GeoJSON feature for `write_features`; ``number`` is its id."""
    head = {"type": "Feature"} if number is None else {"type": "Feature", "id": number}
    return head | {"properties": properties, "geometry": geometry}


def write_features(path: Path, name: str, place: GeoJsonCoordinates, features: Sequence[Mapping[str, Any]]) -> None:
    """Write a GeoJSON file: RFC 7946 in WGS 84, or the survey's own coordinates, which its members declare.

    ``name``: of the collection, which GIS programs show; ``place``: coordinates of the features; ``features``: from
    `feature`. Raises OutputError: the file cannot be written.
    """
    geometries = [each["geometry"] for each in features if each["geometry"] is not None]
    collection = {"type": "FeatureCollection", "name": name, **place.members}
    collection |= {"bbox": shapely.total_bounds(geometries).tolist()} if geometries else {}
    collection["features"] = features
    text = json.dumps(
        collection, ensure_ascii=False, allow_nan=False, separators=(",", ":"), default=shapely.geometry.mapping
    )
    with atomic(path) as temporary:
        temporary.write_bytes(f"{text}\n".encode("utf-8", "backslashreplace"))


@contextmanager
def geojson_writer(
    path: Path, place: GeoJsonCoordinates, about: Mapping[str, Any] | None = None
) -> Iterator[Callable[[Regions], None]]:
    """Write cost.geojson: RFC 7946, one feature per region, WGS 84 with 7 decimals.

    Local coordinates are rounded to 1 mm, and a member of the collection declares them. ``place``: coordinates of the
    file; ``about``: further members of the feature collection, such as vehicle and calibration. Yields a function that
    appends `Regions`; call it repeatedly. Raises OutputError: the file cannot be written.
    """
    head = {"type": "FeatureCollection", "name": "cost", **place.members, **(about or {})}
    encode = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
    boxes: list[NDArray[np.float64]] = []
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(encode(head)[:-1])
        file.write(', "features": [')
        separator = "\n"

        def add(regions: Regions) -> None:
            nonlocal separator
            outlines, columns = place.polygons(regions.outlines), region_columns(regions)
            boxes.append(shapely.total_bounds(outlines))
            for number, geometry in enumerate(_geometries(outlines)):
                properties = {name: values[number] for name, values in columns.items()}
                head = {"type": "Feature", "id": properties["region"], "properties": properties}
                file.write(separator + encode({**head, "geometry": geometry}))
                separator = ",\n"

        yield add
        low, high = np.min(boxes, axis=0)[:2], np.max(boxes, axis=0)[2:]
        file.write(f'\n], "bbox": {encode([*low.tolist(), *high.tolist()])}}}\n')


def _geometries(outlines: NDArray[np.object_]) -> Iterator[dict[str, Any]]:
    """Yield polygons as GeoJSON; converting all at once takes a quarter of the time."""
    _, coordinates, offsets = shapely.to_ragged_array(outlines)
    points, (ring, polygon) = coordinates.tolist(), (offset.tolist() for offset in offsets)
    rings = [points[start:stop] for start, stop in pairwise(ring)]
    for start, stop in pairwise(polygon):
        yield {"type": "Polygon", "coordinates": rings[start:stop]}


@contextmanager
def flatgeobuf_writer(
    path: Path, placement: Placement, about: Mapping[str, str] | None = None
) -> Iterator[Callable[[Regions], None]]:
    """Write cost.fgb: FlatGeobuf with the regions of cost.geojson, in the survey's CRS if it has one.

    FlatGeobuf starts with an index of all features, so regions are first collected in a temporary Arrow file. ``about``
    is metadata of the layer, such as vehicle and calibration. For the rest see `geojson_writer`.
    """
    import pyarrow as pa

    with atomic(path, (pa.ArrowException,)) as temporary:
        waiting = temporary.with_name(f"{temporary.stem}.arrow")
        kinds = ((name, pa.type_for_alias(_KINDS.get(name, "float64"))) for name in _PROPERTIES)
        schema, count = pa.schema([*kinds, (_GEOMETRY, pa.binary())]), 0
        with pa.OSFile(str(waiting), "wb") as file, pa.ipc.new_stream(file, schema) as stream:

            def add(regions: Regions) -> None:
                nonlocal count
                count += len(regions.tiles)
                columns: dict[str, Any] = region_columns(regions)
                columns[_GEOMETRY] = shapely.to_wkb(shapely.transform(regions.outlines, placement.to_crs), byte_order=1)
                stream.write_batch(
                    pa.record_batch([pa.array(columns[field.name], field.type) for field in schema], schema=schema)
                )

            yield add
        _convert(waiting, count, temporary, placement, about or {})


def _convert(waiting: Path, regions: int, temporary: Path, placement: Placement, about: Mapping[str, str]) -> None:
    """Convert the Arrow file ``waiting``, which holds ``regions`` rows, to FlatGeobuf."""
    import pyarrow as pa
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError, FieldError, GeometryError
    from pyogrio.raw import read, write_arrow

    crs = placement.horizontal_crs
    # Small files are made in memory. GDAL takes what follows a '!' in a path for a member of an archive, and does not
    # notice if the disk fills up in the last bytes (seen in 3.8 and 3.12), so the last feature is read back.
    to_disk = waiting.stat().st_size > IN_MEMORY and "!" not in str(temporary)
    target = temporary if to_disk else BytesIO()
    with pa.OSFile(str(waiting), "rb") as file, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="'crs' was not provided")
        try:
            write_arrow(
                pa.ipc.open_stream(file),
                target,
                layer="cost",
                driver="FlatGeobuf",
                geometry_name=_GEOMETRY,
                geometry_type="Polygon",
                crs=None if crs is None else crs.to_wkt(),
                layer_metadata=dict(about),
            )
            if isinstance(target, BytesIO):
                temporary.write_bytes(target.getbuffer())
            else:
                read(temporary, skip_features=regions - 1, max_features=1)
        except (DataLayerError, DataSourceError, FeatureError, FieldError, GeometryError, ValueError) as error:
            raise OSError(str(error)) from error


def region_columns(regions: Regions) -> dict[str, list[Any]]:
    """Return the properties of the regions as Python values; None becomes null."""
    known, names = regions.class_id != NO_CLASS, (*CLASS_NAMES, "unknown")
    # The drives behind c_r: all, or those that got through where many fail.
    basis = np.where(regions.p_fail >= FAIL_SHARE, "survivors", "drives").astype(object)
    basis[np.isnan(regions.c_r)] = None
    return {
        "region": regions.number.tolist(),
        "class": [int(value) if is_known else None for value, is_known in zip(regions.class_id, known, strict=True)],
        "class_name": [names[min(code, len(CLASS_NAMES))] for code in regions.class_id.tolist()],
        "reason": [
            None if is_known else REASON_TEXT[code] for code, is_known in zip(regions.reason, known, strict=True)
        ],
        "passable": regions.passable.tolist(),
        "zone": [number or None for number in regions.zone.tolist()],
        "c_r": plain_numbers(regions.c_r, 6),
        "c_r_low": plain_numbers(regions.c_r_low, 6),
        "c_r_high": plain_numbers(regions.c_r_high, 6),
        "c_r_basis": basis.tolist(),
        "p_fail": plain_numbers(regions.p_fail, 6),
        "hazard": plain_numbers(regions.hazard, 9),
        "cost": plain_numbers(regions.cost, 6),
        "area_m2": plain_numbers(regions.tiles * regions.placement.grid.tile_size**2, 3),
        "tiles": regions.tiles.tolist(),
    }


def plain_numbers(values: NDArray[np.floating], decimals: int) -> list[float | None]:
    """Round numbers, (n,); what is not finite becomes None, since JSON has no NaN."""
    rounded: list[float] = values.round(decimals).tolist()
    return [value if is_number else None for value, is_number in zip(rounded, np.isfinite(values), strict=True)]
