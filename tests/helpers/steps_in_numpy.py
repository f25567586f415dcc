"""`bumpymap.rating.find_steps` in numpy, step by step as its definition says."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_RUN = 4
"""Pixels before and after the middle one of a run."""
_REACH = 4
"""Pixels on each side of a step that are looked at."""
_RIM = 2
"""Pixels along the edges where the rating underestimates a wall: 0.4 m of 3 m."""
_QUANTILE, _QUANTILE_LIMIT = 0.2, 12.0
_PIXEL_LIMIT = 2.5
_RAMP = 0.4
_MEDIAN_DIFFERENCE = 0.9539
"""Median size of the difference of two numbers from a standard normal distribution."""
_LEAST_STEPS = 12
"""With fewer known steps in a tile, its noise is unknown."""
_UNKNOWN_NOISE = 0.15
"""Steps below this do not count where the noise of both sides is unknown, m."""
_SHEARS = (0.0, 0.5, -0.5, 1.0, -1.0)
_LEAST_POINTS, _SURE, _ASTRAY = 5, 3.0, 0.2
_LEVEL_WIDTH = 1.85
_LEAST_ON_RIDGE, _ASTRAY_ON_RIDGE, _FOOT = 2, 0.25, 0.38


def find_steps(heights: NDArray[np.floating], pixels: int, wheel: float = 3.0) -> dict[str, NDArray[np.float32]]:
    """Return the fields of `bumpymap.rating.TileSteps`."""
    z = np.asarray(heights, np.float64)
    (east, noise_east), (south, noise_south) = _gradient(z, pixels), (part.T for part in _gradient(z.T, pixels))
    side = int(np.clip(round(wheel), 2, _REACH))
    level = min(_LEVEL_WIDTH * wheel, (pixels - _RUN - 1) / np.sqrt(2))
    across = _Steps.find(z, east, south, pixels, side)  # walls that run north to south
    along = _Steps.find(z.T, south.T, east.T, pixels, side)
    noise = _PIXEL_LIMIT / _MEDIAN_DIFFERENCE * 0.5 * (noise_east + noise_south)
    limit = np.fmax(_QUANTILE_LIMIT * _usual(across, along, pixels), noise)
    west_east = _with_ridges(across, limit, z, east, south, level)
    north_south = _with_ridges(along, limit.T, z.T, south.T, east.T, level).T
    found = np.fmax(west_east, north_south)
    inner = np.fmax.reduce(_tiles(found, pixels)[1:-1, 1:-1], axis=(2, 3))
    rim = np.fmax(_rim(west_east, pixels), _rim(north_south.T, pixels).T)
    west, east_of = _borders(west_east, pixels)
    north, south_of = (side.T for side in _borders(north_south.T, pixels))
    border = np.stack([north, east_of, south_of, west], axis=-1)
    fields = {"border": border, "inner": inner, "rim": rim}
    return {name: values.astype(np.float32) for name, values in fields.items()}


@dataclass(frozen=True, slots=True)
class _Steps:
    """Steps from west to east at every pixel of a mosaic, m; NaN where a side is unknown."""

    plain: Floats
    """Both sides continued to the middle of the pixel."""
    least: Floats
    """The least step anywhere in the pixel; not negative."""
    crest: Floats
    """The pixel above the runs three and four pixels on both sides of it, m."""

    @classmethod
    def find(cls, z: Floats, east: Floats, south: Floats, pixels: int, side: int) -> "_Steps":
        """Find steps; ``east`` and ``south`` are the gradients of the tiles (tiles, tiles), m per pixel."""
        runs = _medians(z, _each(south, pixels))
        slope = _each(east, pixels)
        right, right_side, bend_right = _side(runs, slope, 1, side)
        left, left_side, bend_left = _side(runs, slope, -1, side)
        up = np.fmin.reduce(right_side) - np.fmax.reduce(left_side)
        down = np.fmin.reduce(left_side) - np.fmax.reduce(right_side)
        nearer = 2.0 / (2.0 + _unknown(right_side) + _unknown(left_side))  # over unknown pixels, it may be a slope
        surely = nearer * np.maximum(up, down)
        share = _share(surely, 0.5 * nearer * np.abs(up - down))
        beside = [_mean(*(_shifted(runs, -way * k, np.nan) for k in (3, 4))) - way * 3.5 * slope for way in (1, -1)]
        crest = z - np.fmax(-np.inf, np.fmax(*beside))
        # The slope on the left is counted away from the pixel, too.
        return cls(right - left, np.maximum(surely * share - 0.5 * np.abs(bend_right + bend_left), 0.0), crest)

    def felt(self, limit: Floats) -> Floats:
        """Return the steps that are the highest of three pixels in a row and stand out from noise and rough ground."""
        known = np.nan_to_num(self.least, nan=-1.0)
        peak = (known >= _shifted(known, 1, -1.0)) & (known >= _shifted(known, -1, -1.0))
        share = _stands_out(self.least, limit)
        return np.where(np.isnan(self.least), np.nan, np.where(peak, self.least * share, 0.0))


def _limit_of_pixels(limit: Floats, pixels: int) -> Floats:
    """Return steps that do not count at each pixel, between those of the tiles two pixels before and behind it."""
    tiles = _each(limit, pixels)
    sides = np.stack([_shifted(tiles, 2, np.nan), _shifted(tiles, -2, np.nan)])
    count = np.isfinite(sides).sum(axis=0)
    square = np.nansum(sides**2, axis=0) / np.maximum(count, 1)
    return np.where(count == 0, _UNKNOWN_NOISE, np.sqrt(square))


def _stands_out(step: Floats, limit: Floats) -> Floats:
    """Return the share of steps that counts: none up to the limit, all from 1.4 times that."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(limit > 0, np.clip((step / limit - 1.0) / _RAMP, 0.0, 1.0), 1.0)


def _gradient(z: Floats, pixels: int) -> tuple[Floats, Floats]:
    """Return the median difference from a pixel to its eastern neighbour in each tile, m; 0 where there is none.

    The second array is the median distance of the differences from it, m; NaN with too few.
    """
    cells = np.diff(_tiles(z, pixels), axis=3)
    steps = cells.reshape(*cells.shape[:2], -1)
    middle = np.nan_to_num(_quantile(steps, 0.5))
    spread = _quantile(np.abs(steps - middle[..., None]), 0.5)
    return middle, np.where(np.isfinite(steps).sum(axis=-1) < _LEAST_STEPS, np.nan, spread)


def _usual(across: _Steps, along: _Steps, pixels: int) -> Floats:
    """Return a low quantile of the size of the steps in each tile whose support lies in the tile; NaN with too few."""
    inside = slice(_REACH, pixels - _REACH), slice(_RUN, pixels - _RUN)
    first = np.abs(_tiles(across.plain, pixels)[:, :, inside[1], inside[0]])
    second = np.abs(_tiles(along.plain, pixels)[:, :, inside[1], inside[0]]).transpose(1, 0, 2, 3)
    both = np.concatenate([part.reshape(*part.shape[:2], -1) for part in (first, second)], axis=-1)
    found = _quantile(both, _QUANTILE)
    return np.where(np.isfinite(both).sum(axis=-1) < _LEAST_STEPS, np.nan, found)


def _quantile(values: Floats, share: float) -> Floats:
    """Return the value with a share of the known values of the last axis at or below it; NaN if none is known."""
    ordered = np.sort(values, axis=-1)  # NaN last
    last = np.isfinite(values).sum(axis=-1) - 1
    place = np.maximum(np.floor(share * last).astype(np.int64), 0)
    return np.asarray(np.take_along_axis(ordered, place[..., None], axis=-1)[..., 0])


def _medians(z: Floats, south: Floats) -> Floats:
    """Return the median of the known ones of nine pixels in a column, each brought to the middle along the slope."""
    stack = np.stack([_shifted(z.T, -k, np.nan).T - k * south for k in range(-_RUN, _RUN + 1)])
    stack.sort(axis=0)
    last = np.isfinite(stack).sum(axis=0) - 1
    low, high = np.maximum(last // 2, 0), np.maximum((last + 1) // 2, 0)
    pair = [np.take_along_axis(stack, place[None], axis=0)[0] for place in (low, high)]
    return np.asarray(0.5 * (pair[0] + pair[1]))


def _side(runs: Floats, slope: Floats, way: int, side: int) -> tuple[Floats, Floats, Floats]:
    """Continue the ground east (1) or west (-1) of every pixel to its middle.

    Returns its height there, m, that from each pixel of the side, and its slope about the tile's, m per pixel away from
    the pixel.
    """
    ground = np.stack([_shifted(runs, -way * k, np.nan) - way * k * slope for k in range(1, _REACH + 1)])
    rises = np.diff(ground, axis=0)
    agree = (rises > 0).all(axis=0) | (rises < 0).all(axis=0)  # False for NaN
    bend = np.where(agree, np.sign(rises[0]) * np.abs(rises).min(axis=0), 0.0)
    continued = ground - bend * np.arange(1, _REACH + 1)[:, None, None]
    return _mean(*continued[:2]), continued[:side], bend


def _mean(near: Floats, far: Floats) -> Floats:
    """Return the mean of two heights; of the known one, if one is."""
    return np.where(np.isnan(near), far, np.where(np.isnan(far), near, 0.5 * (near + far)))


def _unknown(side: Floats) -> NDArray[np.int64]:
    """Return how many pixels of sides come before the first known one, 2 at most."""
    return np.isnan(side[0]) * (1 + np.isnan(side[1]).astype(np.int64))


def _share(surely: Floats, step: Floats) -> Floats:
    """Return how far to believe steps of which so much is sure, 0 to 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(step > 0, np.clip((surely / step - 0.7) / 0.15, 0.0, 1.0), 1.0)


def _with_ridges(steps: _Steps, limit: Floats, z: Floats, east: Floats, south: Floats, level: float) -> Floats:
    """Return steps from west to east as far as the points on both sides bear them out, or ridges, if higher."""
    pixels = len(z) // len(limit)
    limits = _limit_of_pixels(limit, pixels)
    found = steps.felt(limits)
    for r, c in np.argwhere((found > 0) | (steps.crest > limits)):
        at = z, r, c, east[r // pixels, c // pixels], south[r // pixels, c // pixels], level
        if found[r, c] > 0:
            found[r, c] *= _share(np.max([_gap(*at, shear) for shear in _SHEARS]), found[r, c])
        if steps.crest[r, c] > limits[r, c]:
            ridge = np.max([_ridge(*at, shear) for shear in np.arange(-1, 1.25, 0.25)])
            found[r, c] = max(found[r, c], ridge * _stands_out(ridge, limits[r, c]))
    return found


def _around(
    z: Floats, r: int, c: int, east: float, south: float, shear: float, foot: float, level: float
) -> tuple[list[Floats], Floats]:
    """Return heights in order on both sides of a line through a pixel that moves ``shear`` pixels east with every row.

    Sides reach from ``foot`` to ``level``, px. The other heights are those of the line.
    """
    down, across = np.meshgrid(np.arange(-_RUN, _RUN + 1), np.arange(-z.shape[1], z.shape[1] + 1), indexing="ij")
    away = across - shear * down
    rows, cols = r + down, c + across
    inside = (rows >= 0) & (rows < z.shape[0]) & (cols >= 0) & (cols < z.shape[1]) & (np.abs(away) <= level)
    heights, away = z[rows[inside], cols[inside]] - east * across[inside] - south * down[inside], away[inside]
    sides = [_known(heights[(np.abs(away) >= foot) & (np.sign(away) == sign)]) for sign in (-1, 1)]
    return sides, _known(heights[np.abs(away) <= 0.5])


def _known(heights: Floats) -> Floats:
    return np.sort(heights[np.isfinite(heights)])


def _rank(n: int) -> int:
    return max(0, int(min(0.5 * (n - _SURE * np.sqrt(n)), _ASTRAY * n)))


def _gap(z: Floats, r: int, c: int, east: float, south: float, level: float, shear: float) -> float:
    """Height between the sides of a wall through a pixel."""
    sides, _ = _around(z, r, c, east, south, shear, 0.9, level * np.sqrt(1 + shear**2))
    if min(len(side) for side in sides) < _LEAST_POINTS:
        return -np.inf
    low, high = ([side[_rank(len(side))], side[len(side) - 1 - _rank(len(side))]] for side in sides)
    return max(high[0] - low[1], low[0] - high[1])


def _ridge(z: Floats, r: int, c: int, east: float, south: float, level: float, shear: float) -> float:
    """Height of a ridge through a pixel above both of its sides."""
    wide = level * np.sqrt(1 + shear**2)
    sides, top = _around(z, r, c, east, south, shear, _FOOT * wide, wide)
    if min(len(side) for side in sides) < _LEAST_POINTS or len(top) < _LEAST_ON_RIDGE:
        return 0.0
    foot = max(side[(len(side) - 1) // 2] for side in sides)
    high = max(side[len(side) - 1 - _rank(len(side))] for side in sides)
    step = max(top[len(top) // 2] - foot, 0.0)
    return step * float(_share(top[int(_ASTRAY_ON_RIDGE * len(top))] - high, step))


def _shifted(values: Floats, by: int, fill: float) -> Floats:
    """Return ``values`` moved ``by`` columns to the east."""
    out = np.full_like(values, fill)
    if by >= 0:
        out[:, by:] = values[:, : values.shape[1] - by]
    else:
        out[:, :by] = values[:, -by:]
    return out


def _each(of_tiles: Floats, pixels: int) -> Floats:
    """Give every pixel the value of its tile."""
    return np.repeat(np.repeat(of_tiles, pixels, axis=0), pixels, axis=1)


def _tiles(z: Floats, pixels: int) -> Floats:
    """Return a mosaic as (tiles, tiles, pixels, pixels)."""
    rows, columns = (length // pixels for length in z.shape)
    return z.reshape(rows, pixels, columns, pixels).transpose(0, 2, 1, 3)


def _rim(steps: Floats, pixels: int) -> Floats:
    """Return the highest step near the western and eastern borders of the inner tiles; steps from west to east."""
    cells = _tiles(steps, pixels)[1:-1, 1:-1]
    near = np.concatenate([cells[..., :_RIM], cells[..., -_RIM:]], axis=-1)
    return np.asarray(np.fmax.reduce(near, axis=(2, 3)))


def _borders(steps: Floats, pixels: int) -> tuple[Floats, Floats]:
    """Return the highest step at the western and at the eastern border of the inner tiles; steps from west to east."""
    columns = _tiles(steps, pixels)[1:-1]
    west, east = columns[..., 0], columns[..., -1]
    both = np.fmax.reduce(np.fmax(east[:, :-1], west[:, 1:]), axis=2)
    return both[:, :-1], both[:, 1:]
