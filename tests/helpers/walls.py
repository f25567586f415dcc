"""Walls at any place and angle: as mosaics of heights, as surveyed points, and rated with and without their steps."""

import math
from dataclasses import dataclass

import numpy as np

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


def crossed(wall, tiles, least=0.02):
    """Which of the inner tiles the wall crosses, at least that share of them on either side."""
    upper = mosaic(Wall(1.0, wall.easting, wall.northing, wall.turn_deg), tiles)
    share = upper.reshape(tiles, PIXELS, tiles, PIXELS).mean(axis=(1, 3))[1:-1, 1:-1]
    return (share >= least) & (share <= 1 - least)
