"""Made-up routes, and a made-up map under them."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tile_maps import UTM, WARTHOG as VEHICLE, TileMap

from bumpymap.core import NO_TILE, Route, RouteFigures, RouteProfile
from bumpytiles import Grid

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
    return Route(name, georeference, Grid(), corners, stops, profile, FIGURES, VEHICLE, 25.0)


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
