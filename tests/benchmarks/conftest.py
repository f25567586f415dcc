"""A made-up map of 30 m by 18 m: level ground with a wall across it that leaves a gap in the north."""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from tile_maps import where_it_fits

from bumpymap.core import NO_TILE, CostRule, Georeference, RouteVehicle, TileField
from bumpymap.rating import Calibration
from bumpytiles import Grid, TileWindow

sys.path.append(str(Path(__file__).parent))  # the drivers and what they share

ROWS, COLS, PIXELS = 6, 10, 15
WALL_COL = 5


@dataclass
class MadeUpMap:
    """What an evaluation reads of a `MapReader`."""

    calibration: Calibration
    c_r: float = 0.02
    amplitude: float = 0.02

    window = TileWindow(1000, -300, COLS, ROWS)
    grid = Grid()
    vehicle = RouteVehicle("warthog", 1.37, 1.0)
    rule = CostRule(5.0, 300.0, 10.0, 30.0)

    @property
    def calibration_id(self):
        return self.calibration.id

    @property
    def manifests(self):
        files = [{"path": "heightmap.tif", "sha256": "0"}, {"path": "obstacle.tif", "sha256": "1"}]
        return ({"inputs": [{"path": "made/up.laz"}], "files": files},)

    def read(self, window, bands=()):
        barred = np.zeros((ROWS, COLS), np.uint8)
        barred[2:, WALL_COL] = 5
        level = np.full(barred.shape, self.c_r, np.float32)
        p_fail = np.where(barred, 0.9, 0.001).astype(np.float32)
        c_r = np.where(barred, 1.0, level).astype(np.float32)
        bands = [c_r, c_r * 0.8, c_r * 1.25, p_fail, 0 * c_r]
        barred, *bands = (
            self._placed(np.full((window.rows, window.cols), nothing, values.dtype), values, window, 1)
            for values, nothing in ((barred, NO_TILE), *((band, np.nan) for band in bands))
        )
        return TileField(self.grid, Georeference(None), window, barred, *bands, self.rule, self.vehicle)

    def heights(self, window):
        """Sine waves of 3 m along the easting, NaN outside the map, with some gaps."""
        out = np.full((window.rows * PIXELS, window.cols * PIXELS), np.nan, np.float32)
        east = (np.arange(COLS * PIXELS) + 0.5) * self.grid.pixel_size
        whole = np.tile(100 + self.amplitude * np.sin(2 * np.pi * east / 3), (ROWS * PIXELS, 1))
        whole[2 * PIXELS :, WALL_COL * PIXELS + 6 : WALL_COL * PIXELS + 9] += 1.5
        whole[::9, ::7] = np.nan
        return self._placed(out, whole.astype(np.float32), window)

    def objects(self, window):
        out = np.full((window.rows * PIXELS, window.cols * PIXELS), 255, np.uint8)
        return self._placed(out, np.zeros((ROWS * PIXELS, COLS * PIXELS), np.uint8), window)

    def passage(self, window):
        return where_it_fits(self, window)

    def _placed(self, out, whole, window, pixels=PIXELS):
        """Copy what lies in the window; north rows first."""
        own = self.window
        top = (window.row + window.rows - own.row - own.rows) * pixels
        left = (own.col - window.col) * pixels
        row, col = np.indices(out.shape)
        inside = (row >= top) & (row < top + len(whole)) & (col >= left) & (col < left + whole.shape[1])
        out[inside] = whole[row[inside] - top, col[inside] - left]
        return out


@pytest.fixture(scope="session")
def warthog():
    return Calibration.shipped("warthog")


@pytest.fixture
def made_up(warthog):
    return MadeUpMap(warthog)
