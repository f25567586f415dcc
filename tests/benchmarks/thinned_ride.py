"""Thin a survey, add noise, and hold the ride of its tiles against that of all points: no map is written.

    python tests/benchmarks/thinned_ride.py SURVEY|meadow|site [--densities 25,10,4,2] [--noise 0] [--seed 3]

All points count as ground. ``meadow`` and ``site`` are made-up ground of which the roughness varies from place to place
(standard deviations of 4 mm to 5 cm, and 2 mm to 0.3 m), surveyed with 99 points per m2; the noise of the meadow varies
too, from 1.2 to 3 cm. --noise adds errors to the heights of all points [m].

Printed are, of tiles on which fewer than half of the drives fail: rank and median error of C_r; its ratio by third of
that of all points; how often its 80 % interval holds that; its median; and, of made-up ground, the same against the
true ground.
"""

import argparse
from dataclasses import fields

import laspy
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.stats import spearmanr

from bumpymap.core import NO_CLASS, FeatureSettings, Reason
from bumpymap.lab.simulate.model import relief_and_slope
from bumpymap.patches import measure, measure_thin
from bumpymap.rating import THIN_RING, BlockRating, Calibration, RideModel, rate_thin, roll_over, thin_columns
from bumpytiles import Grid, TileBuckets

SIDE, STEP = 120.0, 0.05  # of made-up ground, m
MADE = {"meadow": (0.004, 0.05), "site": (0.002, 0.3)}
NOISE_M = (0.012, 0.03)
MADE_DENSITY = 99.0
PLACE_M = 12.0  # over which roughness and noise vary


def smooth(rng, length):
    """Return a field of unit variance that varies over a length [m]."""
    coarse = gaussian_filter(rng.standard_normal((int(SIDE), int(SIDE))), length, mode="wrap")
    return gaussian_filter(np.kron(coarse / coarse.std(), np.ones((20, 20))), 20)


def between(rng, ends):
    """Return a field that lies between two values."""
    low, high = np.log(ends)
    return np.exp(low + (high - low) / (1.0 + np.exp(-1.5 * smooth(rng, PLACE_M))))


def fractal(rng, hurst, longest=6.0):
    """Return self-affine ground of unit variance."""
    n = int(SIDE / STEP)
    k = np.hypot(np.fft.fftfreq(n, STEP)[:, None], np.fft.rfftfreq(n, STEP))
    gain = np.where(k > 1.0 / longest, np.maximum(k, 1e-9) ** -(hurst + 1.0), 0.0)
    ground = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((n, n))) * gain, s=(n, n))
    return ground / ground.std()


def made(kind, seed):
    """Return made-up ground, south row first, m, and a survey of it."""
    rng = np.random.default_rng(seed)
    share = 0.5 + 0.5 * np.tanh(smooth(rng, 8.0))
    ground = between(rng, MADE[kind]) * (np.sqrt(share) * fractal(rng, 0.4) + np.sqrt(1.0 - share) * fractal(rng, 0.8))
    noise = between(rng, NOISE_M) if kind == "meadow" else np.zeros_like(ground)
    x, y = rng.uniform(0.0, SIDE, (2, rng.poisson(MADE_DENSITY * SIDE**2)))
    at = np.array([y, x]) / STEP - 0.5
    height, error = (map_coordinates(field, at, order=1, mode="nearest") for field in (ground, noise))
    return ground, np.stack([x, y, height + error * rng.standard_normal(len(x))])


def true_ride(ground, model):
    """Return C_r of the tiles of made-up ground, south row first, rad/m."""
    tiles, pixels = int(SIDE / 3.0), model.calibration.pixels
    fine = len(ground) // (tiles * pixels)
    mean = ground.reshape(tiles, pixels, fine, tiles, pixels, fine).mean(axis=(2, 5))
    heights = mean.transpose(0, 2, 1, 3)[:, :, ::-1].reshape(-1, pixels, pixels)
    relief, slope = relief_and_slope(list(heights), 3.0)
    none = np.zeros(len(heights))
    found = model.correction.predict(roll_over(relief, model.operator), slope, none, none + 1e3)
    return np.exp(found.log_c_r).reshape(tiles, tiles)


def ride_of(points, model, corner, shape):
    """Return C_r, both ends of its interval and p_fail, (4, rows, cols), south row first, NaN where unknown."""
    calibration, settings = model.calibration, FeatureSettings()
    buckets = TileBuckets(Grid(calibration.tile_size, calibration.pixels))
    buckets.add(*points, np.ones(points.shape[1], np.uint8))
    wide = tuple(size + 2 * THIN_RING for size in shape)
    laid = {}
    for block in buckets.blocks():
        patches = measure(block, settings, ground_only=False)
        rated = model.rate(patches)
        columns = {f.name: getattr(rated, f.name) for f in fields(BlockRating) if f.name != "reason"}
        columns |= {name: getattr(patches, name) for name in ("reason", "coverage", "slope")}
        pairs, maps = measure_thin(block, patches, settings, ground_only=False)
        columns["thin"] = thin_columns(pairs, maps, patches.count, model.operator)
        for name, values in columns.items():
            gap = {"class_id": NO_CLASS, "reason": Reason.NO_POINTS}.get(name, np.nan)
            field = laid.setdefault(name, np.full((*wide, *values.shape[1:]), gap, values.dtype))
            field[patches.row - corner[1] + THIN_RING, patches.col - corner[0] + THIN_RING] = values
    first = BlockRating(**{f.name: laid[f.name] for f in fields(BlockRating)})
    found = rate_thin(laid["thin"], first, laid["coverage"], laid["slope"], calibration, THIN_RING)
    return np.array([found.c_r, found.c_r_low, found.c_r_high, found.p_fail], np.float64)


def compared(wanted, found, known):
    """Return the cells of a comparison."""
    wanted, (c_r, low, high) = wanted[known], found[:3, known]
    third = np.searchsorted(np.quantile(wanted, [1 / 3, 2 / 3]), wanted)
    inside = (wanted >= low) & (wanted <= high)
    ratio = c_r / wanted
    cells = [
        f"{known.sum()}",
        f"{spearmanr(wanted, c_r).statistic:.3f}",
        f"{100 * np.median(abs(np.log(ratio))):.0f} %",
    ]
    cells += [" / ".join(f"{np.median(ratio[third == k]):.2f}" for k in range(3))]
    cells += [" / ".join(f"{inside[third == k].mean():.2f}" for k in range(3)), f"{inside.mean():.2f}"]
    return [*cells, f"{np.median(c_r):.4f}"]


def main():
    """Print a line for each density."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("survey")
    parser.add_argument("--densities", default="25,10,4,2", help="points per m2")
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--calibration", type=Calibration.load, default=Calibration.shipped("warthog"))
    given = parser.parse_args()
    model, truth = RideModel(given.calibration), None
    if given.survey in MADE:
        ground, points = made(given.survey, given.seed)
        truth = true_ride(ground, model)
    else:
        read = laspy.read(given.survey)
        points = np.stack([np.asarray(axis, np.float64) for axis in (read.x, read.y, read.z)])
    rng = np.random.default_rng([given.seed, 1])
    points[2] += given.noise * rng.standard_normal(points.shape[1])
    size = given.calibration.tile_size
    corner = np.floor(points[:2].min(axis=1) / size).astype(int)
    cols, rows = np.floor(points[:2].max(axis=1) / size).astype(int) - corner + 1
    dense = ride_of(points, model, corner, (rows, cols))
    density = points.shape[1] / (np.isfinite(dense[0]).sum() * size**2)
    print("| points/m2 | against | tiles | rank | median error | ratio by third | interval, by third | all | median |")
    print("|---|---|---|---|---|---|---|---|---|")
    judged = np.isfinite(dense[0]) & (dense[3] < 0.5)
    if truth is not None:
        print("| " + " | ".join([f"{density:.0f}", "truth", *compared(truth, dense, judged)]) + " |")
    for wanted in map(float, given.densities.split(",")):
        kept = rng.random(points.shape[1]) < wanted / density
        found = ride_of(points[:, kept], model, corner, (rows, cols))
        known = judged & np.isfinite(found[0])
        for name, other in (("all points", dense[0]), ("truth", truth)):
            if other is not None:
                print("| " + " | ".join([f"{wanted:g}", name, *compared(other, found, known)]) + " |", flush=True)


if __name__ == "__main__":
    main()
