"""Walls at any place and angle: as mosaics of heights, as surveyed points, and rated with and without their steps."""

import math
from dataclasses import dataclass

import numpy as np
from patch_stacks import joined_in_order

from bumpymap.core import FeatureSettings, Georeference, TextureMap
from bumpymap.patches import measure
from bumpymap.rating import apply_steps, find_steps
from bumpymap.rating.steps import STEP_COLUMNS
from bumpytiles import Grid, TileBuckets

PIXELS, TILE_SIZE = 15, 3.0


@dataclass(frozen=True)
class Wall:
    """Two levels, on both sides of a line through a point; m and degrees."""

    height: float
    easting: float
    northing: float
    turn_deg: float
    slope: tuple[float, float] = (0.0, 0.0)

    def distance(self, easting, northing):
        """Distance to the wall, positive on the upper side."""
        turn = math.radians(self.turn_deg)
        return (easting - self.easting) * math.cos(turn) + (northing - self.northing) * math.sin(turn)

    def ground(self, easting, northing):
        """Heights of points."""
        return self.height * (self.distance(easting, northing) > 0) + self.slope[0] * easting + self.slope[1] * northing


def mosaic(wall, tiles):
    """Heights of tiles x tiles tiles from the origin on, north row first: the mean of each pixel."""
    fine = 8
    axis = (np.arange(tiles * PIXELS * fine) + 0.5) * TILE_SIZE / PIXELS / fine
    z = wall.ground(*np.meshgrid(axis, axis[::-1]))
    n = tiles * PIXELS
    return z.reshape(n, fine, n, fine).mean(axis=(1, 3)).astype(np.float32)


def surveyed(wall, tiles, density, noise, rng):
    """Survey tiles x tiles tiles and measure them."""
    side = tiles * TILE_SIZE
    easting, northing = rng.random((2, rng.poisson(density * side**2))) * side
    upward = wall.ground(easting, northing) + rng.normal(0, noise, len(easting))
    buckets = TileBuckets(Grid(TILE_SIZE, PIXELS))
    buckets.add(easting, northing, upward, np.zeros(len(upward), np.bool_))
    return joined_in_order(measure(block, FeatureSettings(), ground_only=False) for block in buckets.blocks())


def image(patches, values, tiles):
    """Values of tiles as an image, north row first."""
    out = np.full((tiles, tiles, *values.shape[1:]), np.nan, values.dtype)
    out[tiles - 1 - patches.row, patches.col] = values
    return out


def rated(patches, model, tiles):
    """Columns of the inner tiles, without and with their steps."""
    unknown = TextureMap(np.full((len(patches.col), 4), np.nan, np.float32))
    cost = model.rate(patches, unknown, Georeference(None))
    before = {name: image(patches, cost.band(name), tiles)[1:-1, 1:-1] for name in STEP_COLUMNS if name != "class_id"}
    before["class_id"] = image(patches, cost.class_id.astype(float), tiles)[1:-1, 1:-1].astype(np.uint8)
    before["coverage"] = image(patches, patches.coverage, tiles)[1:-1, 1:-1]
    heights = image(patches, patches.heights, tiles).transpose(0, 2, 1, 3)
    steps = find_steps(heights.reshape(tiles * PIXELS, -1), PIXELS)
    return before, apply_steps(before, steps.unseen, model.calibration), steps


def crossed(wall, tiles, least=0.02):
    """Which of the inner tiles the wall crosses, at least that share of them on either side."""
    upper = mosaic(Wall(1.0, wall.easting, wall.northing, wall.turn_deg), tiles)
    share = upper.reshape(tiles, PIXELS, tiles, PIXELS).mean(axis=(1, 3))[1:-1, 1:-1]
    return (share >= least) & (share <= 1 - least)
