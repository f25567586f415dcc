"""Maps in memory whose tiles, heights and risks a test chooses; made-up routes, and what ways over them must be."""

import json
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from pyproj import CRS
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from bumpymap.core.route_types import Route, RouteFigures, RouteProfile, RouteVehicle, TileField
from bumpymap.core.types import NO_TILE, OBSTACLE, Barred, CostRule, Georeference
from bumpymap.layers import MapReader
from bumpymap.route.search import Costs
from bumpytiles import Grid, TileWindow

GRID = Grid()
UTM = Georeference(CRS.from_epsg(32614))
WARTHOG = RouteVehicle("warthog", 1.38, 2.0)
RULE = CostRule(ride_weight=5.0, fail_weight=300.0, drive_m=10.0, slope_limit_deg=30.0, speeds=((0.15, 2.0),))


def where_it_fits(site, window):
    """Pixels 0.1 m and half the vehicle's width from obstacles and from tiles that their ground bars."""
    pixels, reach = site.grid.pixels, (0.5 * site.vehicle.width_m + 0.1) / site.grid.pixel_size
    ring = 2
    wide = TileWindow(window.col - ring, window.row - ring, window.cols + 2 * ring, window.rows + 2 * ring)
    by_ground = ~np.isin(site.read(wide).barred, (Barred.NO, Barred.OBSTACLE, Barred.SPLIT))
    by_ground = np.repeat(np.repeat(by_ground, pixels, 0), pixels, 1)
    free = np.ones(by_ground.shape, bool)
    for closed, near in ((site.objects(wide) == OBSTACLE, reach), (by_ground, min(reach, 0.45 * pixels) + 0.5)):
        if closed.any():
            free &= distance_transform_edt(~closed) >= near
    inner = slice(ring * pixels, -ring * pixels)
    return free[inner, inner]


@dataclass
class TileMap:
    """A map in memory; arrays are (rows, cols), north row first."""

    c_r: np.ndarray
    barred: np.ndarray = None
    p_fail: np.ndarray = None
    obstacle: np.ndarray = None
    height: object = None
    """Height [m] at easting and northing; None: level ground."""
    west: int = 160_000
    south: int = 712_000
    grid: Grid = GRID
    georeference: Georeference = UTM
    rule: CostRule = RULE
    vehicle: RouteVehicle = WARTHOG
    has_crs: bool = True
    smallest_object: float | np.ndarray = 0.7
    """m, of all tiles or of each."""
    windows: list = field(default_factory=list)
    stones: list = field(default_factory=list)

    def __post_init__(self):
        self.c_r = np.asarray(self.c_r, np.float32)
        self.barred = np.zeros(self.c_r.shape, np.uint8) if self.barred is None else np.asarray(self.barred, np.uint8)
        self.p_fail = np.zeros_like(self.c_r) if self.p_fail is None else np.asarray(self.p_fail, np.float32)
        self.obstacle = np.zeros_like(self.c_r) if self.obstacle is None else np.asarray(self.obstacle, np.float32)

    @property
    def window(self):
        rows, cols = self.c_r.shape
        return TileWindow(self.west, self.south, cols, rows)

    def at(self, row, col):
        """Easting and northing of field coordinates."""
        return np.array([self.west + col, self.south + len(self.c_r) - row]) * self.grid.tile_size

    def _cut(self, values, window, nothing):
        out = np.full((window.rows, window.cols), nothing, values.dtype)
        rows = self.south + len(values) - (window.row + window.rows) + np.arange(window.rows)
        cols = window.col - self.west + np.arange(window.cols)
        in_rows, in_cols = ((at >= 0) & (at < size) for at, size in zip((rows, cols), values.shape, strict=True))
        out[np.ix_(in_rows, in_cols)] = values[np.ix_(rows[in_rows], cols[in_cols])]
        return out

    def read(self, window, bands=()):
        self.windows.append(window)
        c_r = self._cut(self.c_r, window, np.nan)
        return TileField(
            self.grid,
            self.georeference,
            window,
            self._cut(self.barred, window, NO_TILE),
            c_r,
            c_r * np.float32(0.8),
            c_r * np.float32(1.25),
            self._cut(self.p_fail, window, np.nan),
            self._cut(self.obstacle, window, np.nan),
            *(
                self._cut(np.broadcast_to(value, self.c_r.shape).astype(np.float32), window, np.nan)
                for value in (10.0, self.smallest_object, 0.2)
            ),
            self.rule,
            self.vehicle,
        )

    def objects(self, window):
        """Chosen pixels with an obstacle: easting and northing, m."""
        pixels = self.grid.pixels
        out = np.zeros((window.rows * pixels, window.cols * pixels), np.uint8)
        size = self.grid.tile_size / pixels
        for easting, northing in self.stones:
            row = int((window.row + window.rows) * pixels - np.floor(northing / size) - 1)
            col = int(np.floor(easting / size) - window.col * pixels)
            if 0 <= row < out.shape[0] and 0 <= col < out.shape[1]:
                out[row, col] = OBSTACLE
        return out

    def passage(self, window):
        return where_it_fits(self, window)

    gradient = MapReader.gradient

    def heights(self, window):
        pixel = self.grid.tile_size / self.grid.pixels
        rows, cols = window.rows * self.grid.pixels, window.cols * self.grid.pixels
        if self.height is None:
            return np.zeros((rows, cols), np.float32)
        north = (window.row + window.rows) * self.grid.tile_size - (np.arange(rows) + 0.5) * pixel
        east = window.col * self.grid.tile_size + (np.arange(cols) + 0.5) * pixel
        return self.height(east[None, :], north[:, None]).astype(np.float32)


CORNERS = np.array([[330_010.0, 2_040_020.0], [330_100.0, 2_040_080.0], [330_250.0, 2_040_050.0]])
FIGURES = RouteFigures(
    *(261.135, 241.868, 301.5, 0.11, 0.09, 0.14, 0.31, 0.25, 0.4), *(0.05, 0.2, 12.0, 3.0, 12.5, 4.5, 2.25, 130.5675)
)


def make_route(name="route", corners=CORNERS, *, georeference=UTM, step=2.0, stops=None):
    """Route along corners, on wavy ground; every seventh value of its profile is unknown."""
    corners = np.asarray(corners, float)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    distance = np.linspace(0.0, along[-1], max(2, int(along[-1] / step) + 1)) if along[-1] > 0 else np.zeros(1)
    easting, northing = (np.interp(distance, along, axis) for axis in corners.T)
    rng = np.random.default_rng(0)
    low, middle, high = np.sort(rng.gamma(2.0, 0.1, (3, len(distance))), axis=0)
    gap = np.arange(len(distance)) % 7 == 3
    *unknown, speed = [
        np.where(gap, np.nan, values) for values in (middle, low, high, rng.random(len(distance)) * 0.3, 1.0 + gap)
    ]
    z = np.where(gap, np.nan, 2250.0 + 3.0 * np.sin(distance / 20.0))
    profile = RouteProfile(
        distance,
        easting,
        northing,
        z,
        np.gradient(z) if len(z) > 1 else z,
        *unknown,
        distance * 1.2,
        gap,
        1.1 * unknown[0],
        speed,
    )
    stops = corners[[0, -1]] if stops is None else np.asarray(stops, float)
    return Route(name, georeference, Grid(), corners, stops, profile, FIGURES, WARTHOG, 25.0)


MADE_UP = Path(__file__).parent / "made_up_map"
"""A folder with no more than the manifest of a map."""


@dataclass
class MadeUpMap(TileMap):
    """A map in memory, for `MapReader`; ``height`` is one for each tile, (rows, cols) m."""

    fits: np.ndarray | None = None
    """(rows * pixels, cols * pixels) where the middle of the vehicle can be; everywhere if None."""
    folder: Path = MADE_UP

    @property
    def manifest(self):
        return json.loads((self.folder / "run.json").read_text())

    @classmethod
    def around(cls, corners=CORNERS, margin=40, seed=1):
        """Tiles of every kind around some points."""
        low, high = (np.floor(edge / 3.0).astype(int) for edge in (np.min(corners, axis=0), np.max(corners, axis=0)))
        cols, rows = (high - low + 2 * margin + 1).tolist()
        rng = np.random.default_rng(seed)
        barred = rng.choice([0, 0, 0, 1, 2, 3, 4, 5, NO_TILE], (rows, cols)).astype(np.uint8)
        c_r = np.where((barred == 1) | (barred == NO_TILE), np.nan, rng.gamma(2.0, 0.1, (rows, cols)))
        height = np.zeros((rows, cols), np.float32)
        return cls(c_r, barred, height=height, west=int(low[0]) - margin, south=int(low[1]) - margin)

    def relief(self, window, shape):
        return _thinned(self._cut(self.height, window, np.nan), shape)

    def photo(self, window, shape):
        return None

    def objects(self, window, shape):
        return np.zeros(shape, np.uint8)

    def passage(self, window, shape):
        if self.fits is None:
            return np.ones(shape, bool)
        whole = np.zeros((window.rows * self.grid.pixels, window.cols * self.grid.pixels), bool)
        top = (self.south + len(self.c_r) - window.row - window.rows) * self.grid.pixels
        left = (window.col - self.west) * self.grid.pixels
        row, col = np.indices(whole.shape) + np.array([top, left])[:, None, None]
        inside = (row >= 0) & (row < len(self.fits)) & (col >= 0) & (col < self.fits.shape[1])
        whole[inside] = self.fits[row[inside], col[inside]]
        return _thinned(whole, shape)


def _thinned(values, shape):
    row, col = (np.arange(n) * size // n for n, size in zip(shape, values.shape, strict=True))
    return values[np.ix_(row, col)]


def smooth_field(rng, shape, *, most=8.0, width=2, closed=0.0):
    """Costs from 1 to ``most``, smoothed over ``width`` tiles; the dearest share is closed."""
    cost = rng.random(shape)
    for axis in (0, 1):
        for _ in range(width):
            cost = (cost + np.roll(cost, 1, axis)) / 2
    cost = (cost - cost.min()) / (cost.max() - cost.min())
    limit = np.quantile(cost, 1.0 - closed)
    return np.where(cost > limit, np.inf, 1.0 + (most - 1.0) * cost).astype(np.float32)


def with_slope(rng, cost, steepest=0.25):
    """The same field with slopes of up to a half or so."""
    gradient = rng.normal(0.0, 0.15, (*cost.shape, 2)).astype(np.float32)
    return Costs(cost, gradient, 6.0, 2.0, 3.0, steepest)


def crossed(row, col):
    """(tile, share) of a move by brute force: the share of it in each tile, from cuts at all borders, ends included."""
    cuts = {0.0, 1.0}
    for delta in (row, col):
        cuts |= {(k + 0.5) / abs(delta) for k in range(abs(delta))}
    cuts = sorted(cuts)
    return [
        ((int(np.floor(0.5 + row * (a + b) / 2)), int(np.floor(0.5 + col * (a + b) / 2))), b - a)
        for a, b in pairwise(cuts)
        if b - a > 1e-12
    ]


@cache
def near_tiles(row, col, margin):
    """Tiles whose squares are nearer than a margin to a move."""
    line = shapely.LineString([(0.5, 0.5), (col + 0.5, row + 0.5)])
    r, c = np.mgrid[-5:6, -5:6]
    near = shapely.distance(line, shapely.box(c, r, c + 1, r + 1)) < max(margin, 1e-6) - 1e-9
    return np.column_stack([r[near], c[near]])


def along(cost, row, col):
    """Costs of tiles in a direction, with what slopes add to them."""
    if not isinstance(cost, tuple):
        return cost
    south, east = np.moveaxis(cost.gradient.astype(np.float64), -1, 0)
    off, steep = np.arctan2(row, col) - np.arctan2(south, east), np.hypot(south, east)
    rise, across = steep * np.cos(off), steep * np.abs(np.sin(off))
    more = np.where(rise > 0.0, cost.climb, -cost.descent) * rise + cost.side * across
    return cost.tiles + np.where(across > cost.steepest, np.inf, more)


def move_graph(cost, moves, margin):
    """All moves of a window as a sparse graph; a move is there if no closed square is nearer than the margin."""
    is_open = np.isfinite(cost.tiles if isinstance(cost, tuple) else cost)
    rows, cols = is_open.shape
    ring, closed = np.full((rows + 10, cols + 10), np.inf), np.pad(~is_open, 5, constant_values=True)
    starts, ends, weights = [], [], []
    i, j = np.nonzero(is_open)
    for row, col in moves.tolist():
        ring[5:-5, 5:-5] = along(cost, row, col)
        total = np.hypot(row, col) * sum(share * ring[i + r + 5, j + c + 5] for (r, c), share in crossed(row, col))
        for r, c in near_tiles(row, col, margin):
            total[closed[i + r + 5, j + c + 5]] = np.inf
        kept = np.isfinite(total)
        starts.append((i * cols + j)[kept])
        ends.append(((i + row) * cols + j + col)[kept])
        weights.append(total[kept])
    pairs = np.concatenate(starts), np.concatenate(ends)
    return csr_array((np.concatenate(weights), pairs), shape=(rows * cols, rows * cols))


def reach_by_graph(cost, moves, margin, tile):
    """(rows, cols) cost from the middle of a tile to all others."""
    rows, cols = (cost.tiles if isinstance(cost, tuple) else cost).shape
    return dijkstra(move_graph(cost, moves, margin), indices=tile[0] * cols + tile[1]).reshape(rows, cols)


def gap_to_closed(cost, line):
    """Least distance of a line to closed tiles of the window."""
    path, (row, col) = shapely.LineString(np.asarray(line)[:, ::-1]), np.nonzero(~np.isfinite(cost))
    return float(shapely.distance(path, shapely.box(col, row, col + 1, row + 1)).min(initial=np.inf))


def cheapest_on_pixels(cost, start, goal, pixel):
    """Cost [m] of the cheapest path over pixels in eight directions; inf if there is none.

    A move past a corner needs the pixels beside it to be free.
    """
    rows, cols = cost.shape
    free, number = np.isfinite(cost), np.arange(cost.size).reshape(cost.shape)
    parts = []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = np.s_[: rows - down, max(0, -right) : cols - max(0, right)]
        there = np.s_[down:, max(0, right) : cols + min(0, right)]
        corners = np.s_[: rows - down, max(0, right) : cols + min(0, right)], np.s_[down:, here[1].start : here[1].stop]
        kept = free[here] & free[there] & free[corners[0]] & free[corners[1]]
        length = np.hypot(down, right) * pixel
        parts.append((number[here][kept], number[there][kept], length * 0.5 * (cost[here][kept] + cost[there][kept])))
    first, last, weight = (np.concatenate(each) for each in zip(*parts, strict=True))
    graph = csr_array((weight.astype(np.float64), (first, last)), (cost.size,) * 2)
    return dijkstra(graph, directed=False, indices=number[tuple(start)])[number[tuple(goal)]]
