"""A made-up site that is surveyed twice: rolling ground, noise of each survey, and what was done to it between them."""

from dataclasses import replace

import numpy as np
from cost_maps import make_map

from bumpytiles import Grid

ROWS, COLS = 30, 40
WEST, SOUTH = 160_000, 712_000
PIXELS = 15
RUT = [(14, col) for col in range(40)]
"""Rows (from the north) and columns of the tiles with a rut."""


def survey(
    seed, *, noise=0.03, rise=0.0, rut=0.0, lowered=0.0, seen=1.0, c_r=None, tiles=None, shift=(0.0, 0.0),
    tilt=(0.0, 0.0), relief=1.0, **options,
):  # fmt: skip
    """One survey.

    ``rut`` is the depth, m, of a groove of three pixels along ``RUT``, ``lowered`` that of these tiles as a whole,
    ``seen`` a share of the pixels, ``c_r`` a factor on the ride cost of these tiles; ``shift`` is how
    far east and north all lies, m, ``tilt`` the rise eastwards and northwards, ``relief`` a factor on the hills.
    """
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[0:ROWS, 0:COLS]
    kept = np.ones((ROWS, COLS), bool) if tiles is None else tiles
    row, col = row[kept], col[kept]
    n = len(row)
    grid = options.pop("grid", None) or Grid(3.0, PIXELS)
    pixel = (np.arange(grid.pixels) + 0.5) / grid.pixels
    north = (SOUTH + ROWS - row)[:, None, None] - pixel[None, :, None]
    east = (WEST + col)[:, None, None] + pixel[None, None, :]
    lies_east, lies_north = east - shift[0] / 3.0, north - shift[1] / 3.0  # in tiles
    heights = 200.0 + relief * (np.sin(lies_east / 3.0) + 0.5 * np.cos(lies_north / 2.0)) + rise
    heights += 3.0 * (tilt[0] * (east - WEST) + tilt[1] * (north - SOUTH))
    heights += noise * rng.standard_t(4, heights.shape)
    in_rut = np.isin(row * COLS + col, [r * COLS + c for r, c in RUT])
    heights[in_rut, 6:9] -= rut
    heights[in_rut] -= lowered
    heights[rng.random(heights.shape) >= seen] = np.nan
    made = make_map(
        WEST + col, SOUTH + ROWS - 1 - row, np.zeros(n), np.zeros(n), grid=grid, seed=1, easy=True, **options
    )
    ride = np.full(n, 0.1) * np.exp(rng.normal(0.0, 0.05, n))
    if c_r is not None:
        ride = ride * np.where(in_rut, c_r, 1.0)
    ride = ride.astype(np.float32)
    patches = replace(
        made.patches, heights=heights.astype(np.float32), density=np.full(n, 100.0 * seen), coverage=np.full(n, seen)
    )
    bands = {"c_r": ride, "c_r_low": ride * np.float32(0.88), "c_r_high": ride * np.float32(1.13)}
    return replace(made, patches=patches, probability=None, p_fail=np.full(n, 0.01, np.float32), **bands)
