"""Made-up routes, and a made-up map under them."""

from dataclasses import dataclass, field

import numpy as np
from pyproj import CRS

from bumpymap.core import (
    NO_TILE,
    CostRule,
    Georeference,
    Route,
    RouteFigures,
    RouteProfile,
    RouteVehicle,
    TileField,
)
from bumpytiles import Grid, TileWindow

UTM = Georeference(CRS.from_epsg(32614))
VEHICLE = RouteVehicle("warthog", 1.38, 2.0)
CORNERS = np.array([[330_010.0, 2_040_020.0], [330_100.0, 2_040_080.0], [330_250.0, 2_040_050.0]])
FIGURES = RouteFigures(
    *(261.135, 241.868, 301.5, 0.11, 0.09, 0.14, 0.31, 0.25, 0.4),
    *(0.05, 0.2, 12.0, 3.0, 12.5, 4.5, 2.25, 130.5675),
)


def make_route(name="route", corners=CORNERS, *, georeference=UTM, step=2.0, figures=FIGURES, stops=None, seed=0):
    """Route along corners, on wavy ground; every seventh value of its profile is unknown."""
    corners = np.asarray(corners, float)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    distance = np.linspace(0.0, along[-1], max(2, int(along[-1] / step) + 1)) if along[-1] > 0 else np.zeros(1)
    easting, northing = (np.interp(distance, along, axis) for axis in corners.T)
    rng = np.random.default_rng(seed)
    low, middle, high = np.sort(rng.gamma(2.0, 0.1, (3, len(distance))), axis=0)
    gap = np.arange(len(distance)) % 7 == 3
    unknown = [np.where(gap, np.nan, values) for values in (middle, low, high, rng.random(len(distance)) * 0.3)]
    z = np.where(gap, np.nan, 2250.0 + 3.0 * np.sin(distance / 20.0))
    profile = RouteProfile(
        distance, easting, northing, z, np.gradient(z) if len(z) > 1 else z, *unknown, distance * 1.2, gap
    )
    stops = corners[[0, -1]] if stops is None else np.asarray(stops, float)
    return Route(name, georeference, Grid(), corners, stops, profile, figures, VEHICLE, 25.0)


@dataclass
class MadeUpMap:
    """A map in memory, for `MapSource`."""

    window: TileWindow
    barred: np.ndarray
    c_r: np.ndarray
    height: np.ndarray
    """(rows, cols) m: one height a tile."""
    fits: np.ndarray | None = None
    """(rows * pixels, cols * pixels) where the middle of the vehicle can be; everywhere if None."""
    grid: Grid = field(default_factory=Grid)
    georeference: Georeference = UTM
    folders: tuple = ()
    manifests: tuple = ({"vehicle": {"name": "warthog"}, "calibration": {"id": "c0ffee"}},)
    windows_read: list = field(default_factory=list)

    @classmethod
    def around(cls, corners=CORNERS, margin=40, seed=1):
        """Tiles of every kind around some points."""
        low, high = (np.floor(edge / 3.0).astype(int) for edge in (np.min(corners, axis=0), np.max(corners, axis=0)))
        cols, rows = (high - low + 2 * margin + 1).tolist()
        window = TileWindow(int(low[0]) - margin, int(low[1]) - margin, cols, rows)
        rng = np.random.default_rng(seed)
        barred = rng.choice([0, 0, 0, 1, 2, 3, 4, 5, NO_TILE], (rows, cols)).astype(np.uint8)
        c_r = np.where((barred == 1) | (barred == NO_TILE), np.nan, rng.gamma(2.0, 0.1, (rows, cols)))
        return cls(window, barred, c_r.astype(np.float32), np.zeros((rows, cols), np.float32))

    def _cut(self, values, window, nothing):
        out = np.full((window.rows, window.cols), nothing, values.dtype)
        rows = self.window.row + self.window.rows - (window.row + window.rows) + np.arange(window.rows)
        cols = window.col - self.window.col + np.arange(window.cols)
        in_rows, in_cols = ((at >= 0) & (at < size) for at, size in zip((rows, cols), values.shape, strict=True))
        out[np.ix_(in_rows, in_cols)] = values[np.ix_(rows[in_rows], cols[in_cols])]
        return out

    def read(self, window, bands=()):
        self.windows_read.append(window)
        barred, c_r = self._cut(self.barred, window, NO_TILE), self._cut(self.c_r, window, np.nan)
        rule = CostRule(5.0, 300.0, 10.0, 30.0)
        return TileField(self.grid, self.georeference, window, barred, c_r, c_r, c_r, c_r, c_r, rule, VEHICLE)

    def relief(self, window, shape):
        tiles = self._cut(self.height, window, np.nan)
        row, col = (np.arange(n) * size // n for n, size in zip(shape, tiles.shape, strict=True))
        return tiles[np.ix_(row, col)]

    def passage_shown(self, window, shape):
        if self.fits is None:
            return np.ones(shape, bool)
        pixels = self.grid.pixels
        tiles = [
            np.repeat(np.arange(first, first + size), pixels)
            for first, size in ((self._top(window), window.rows), (window.col - self.window.col, window.cols))
        ]
        places = [tile * pixels + np.arange(len(tile)) % pixels for tile in tiles]
        whole = np.zeros((len(places[0]), len(places[1])), bool)
        inside = [(at >= 0) & (at < size) for at, size in zip(places, self.fits.shape, strict=True)]
        whole[np.ix_(*inside)] = self.fits[np.ix_(*(at[here] for at, here in zip(places, inside, strict=True)))]
        row, col = (np.arange(n) * size // n for n, size in zip(shape, whole.shape, strict=True))
        return whole[np.ix_(row, col)]

    def _top(self, window):
        return self.window.row + self.window.rows - (window.row + window.rows)
