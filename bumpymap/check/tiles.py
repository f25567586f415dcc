"""What drives measured of each tile of a map."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from bumpymap.check.drive_measure import DriveMeasure
from bumpymap.check.ground import DriveSteps
from bumpymap.check.stretches import less_floor, reading_sd
from bumpymap.core import Barred, DrivenTiles, TileField

__all__ = ["TileDrive", "driven_tiles"]

Floats = NDArray[np.float64]

_LEAST_WAY_M = 1.0
"""Tiles with less of the way are left out."""
_NEAR_STEPS = 12
"""Steps that make up the way over a tile: the scale on which its neighbours differ."""


@dataclass(frozen=True, slots=True)
class TileDrive:
    """A drive over tiles."""

    drive: DriveMeasure
    steps: DriveSteps
    length_share: float
    """Error of the length of its stretches, as a share."""


def driven_tiles(drives: Sequence[TileDrive], field: TileField, limits: tuple[float, ...]) -> DrivenTiles:
    """Return C_r of each tile of all drives together.

    Parameters
    ----------
    drives : sequence of TileDrive
    field : TileField
    limits : tuple of float
        Of the classes, rad/m.
    """
    count = field.barred.size
    sums, moments = np.zeros((4, count)), np.zeros((3, count))
    for one in drives:
        steps = one.steps
        likely = _chance(steps, field)
        weight = likely * (steps.tile >= 0)
        near = _near(steps)
        variance = _reading_variance(one, near)
        whole = (steps.turned, steps.way_m, variance * steps.way_m, one.drive.floor * steps.seconds)
        sums += [_over_tiles(steps, values[:, None] * weight, count) for values in whole]
        way = steps.way_m[:, None] * weight
        parts = (near[:, None] * way, near[:, None] ** 2 * way, _certain(steps, likely) * way)
        moments += [_over_tiles(steps, part, count) for part in parts]
    found = np.flatnonzero((sums[1] >= _LEAST_WAY_M) & np.isfinite(field.c_r.ravel()))
    turned, way, variance, floor = sums[:, found]
    mean, square, certain = moments[:, found] / way
    mixed = (1.0 - np.clip(certain, 0.0, 1.0)) * np.maximum(square - mean**2, 0.0)
    measured = less_floor(turned / way, floor / way)
    row, col = np.divmod(found, field.window.cols)
    c_r, low, high = (part.ravel()[found].astype(np.float64) for part in (field.c_r, field.c_r_low, field.c_r_high))
    return DrivenTiles(
        col=col + field.window.col,
        row=field.window.row + field.window.rows - 1 - row,
        way_m=way,
        measured=measured,
        measured_sd=np.sqrt(variance / way + mixed),
        c_r=c_r,
        c_r_low=low,
        c_r_high=high,
        class_id=np.digitize(c_r, limits).astype(np.uint8),
    )


def _chance(steps: DriveSteps, field: TileField) -> Floats:
    """Return the probability of each place of each step, (s, 25): not on barred ground, unless all of it is."""
    open_ = (steps.tile >= 0) & (field.barred.ravel()[steps.tile] == Barred.NO)
    chance = np.where(open_.any(axis=1, keepdims=True), open_, True) * steps.chance
    return np.asarray(chance / chance.sum(axis=1, keepdims=True))


def _near(steps: DriveSteps) -> Floats:
    """Return C_r around each step, over about the length of a tile, rad/m."""
    turned, way = (uniform_filter1d(part, _NEAR_STEPS, mode="nearest") for part in (steps.turned, steps.way_m))
    return np.asarray(turned / np.maximum(way, 1e-9))


def _certain(steps: DriveSteps, likely: Floats) -> Floats:
    """Return the probability that a step lies on the tile of each of its places, (s, 25)."""
    order = np.argsort(steps.tile, axis=1, kind="stable")
    tile = np.take_along_axis(steps.tile, order, axis=1)
    chance = np.take_along_axis(likely, order, axis=1)
    new = np.concatenate([np.ones((len(tile), 1), np.bool_), tile[:, 1:] != tile[:, :-1]], axis=1)
    group = np.cumsum(new.ravel()) - 1
    each = np.bincount(group, chance.ravel())[group].reshape(tile.shape)
    out: Floats = np.empty(each.shape)
    np.put_along_axis(out, order, each, axis=1)
    return out


def _over_tiles(steps: DriveSteps, values: Floats, count: int) -> Floats:
    """Sum values (s, 25) by tile."""
    return np.asarray(np.bincount(np.maximum(steps.tile, 0).ravel(), values.ravel(), minlength=count), np.float64)


def _reading_variance(one: TileDrive, near: Floats) -> Floats:
    """Return the variance of C_r of one metre around each step that sensor and length leave, (rad/m)^2."""
    drive, steps = one.drive, one.steps
    seconds, way = (uniform_filter1d(part, _NEAR_STEPS, mode="nearest") for part in (steps.seconds, steps.way_m))
    pace = seconds / np.maximum(way, 1e-9)
    sd = reading_sd(drive, near, less_floor(near, drive.floor * pace), pace, np.ones_like(near))
    return np.asarray(sd**2 + (one.length_share * near) ** 2)
