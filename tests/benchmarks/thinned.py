"""Thin a survey, add noise, and hold its maps, the ride of its tiles or drives along lines against those of all points.

    python tests/benchmarks/thinned.py maps SURVEY [--crs CRS] [--densities 10,6] [--noise 0] [--seed 1] [--ground]
    python tests/benchmarks/thinned.py ride SURVEY|meadow|site [--densities 25,10,4,2] [--noise 0] [--seed 3]
    python tests/benchmarks/thinned.py lines SURVEY|meadow|site [--crs CRS] [--densities 99,25] [--noise 0]
        [--lines 120] [--engine dart|mujoco] [--vehicle warthog]

--noise adds errors to the heights of points [m]. ``meadow`` and ``site`` are made-up ground of which the roughness
varies from place to place (standard deviations of 4 mm to 5 cm, and 2 mm to 0.3 m), surveyed with 99 points per m2; the
noise of the meadow varies too, from 1.2 to 3 cm.

maps: random copies of a survey with fewer points against the map of all points. A copy bars a tile if it is passable in
the map of all points and not in that of the copy; unknown tiles of the copy count as barred, and are named. It opens
one that is barred, and not unknown, in the map of all points. --ground calls every point ground, so that both rate the
objects on it too.

ride: of tiles, without a map; all points count as ground. Printed are, of tiles on which fewer than half of the drives
fail: rank and median error of C_r; its ratio by third of that of all points; how often its 80 % interval holds that;
its median; and, of made-up ground, the same against the true ground.

lines: drives along lines of 10 m over the ground of the map of the survey as it is, away from obstacles and steep
tiles, or over the made-up one, against the rides that maps of copies with fewer points and with errors predict. Each
line is driven once, beside its own place by an error of 0.3 m (standard deviation), as `ride_along` reckons with.
MuJoCo is another engine (see second_engine.py); DART needs the extra `sim`.
"""

import argparse
import math
import tempfile
from dataclasses import dataclass, fields
from functools import partial
from multiprocessing import Pool
from pathlib import Path

import laspy
import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates, uniform_filter
from scipy.stats import spearmanr
from second_engine import SecondVehicle

import bumpymap
from bumpymap.core import BARRED_TEXT, CANOPY, CROSSING_UNKNOWN, NO_CLASS, OBSTACLE, Barred, FeatureSettings, Reason
from bumpymap.lab.settings import DriveSettings
from bumpymap.lab.simulate.drive import Start, drive_strip, follow
from bumpymap.lab.simulate.model import DartVehicle, relief_and_slope
from bumpymap.layers import open_map
from bumpymap.patches import measure, measure_thin
from bumpymap.rating import THIN_RING, BlockRating, Calibration, RideModel, rate_thin, roll_over, thin_columns
from bumpytiles import Grid, TileBuckets

TEXTS = {text: code for code, text in BARRED_TEXT.items()}
SIDE, STEP = 120.0, 0.05  # of made-up ground, m
MADE = {"meadow": (0.004, 0.05), "site": (0.002, 0.3)}
NOISE_M = (0.012, 0.03)
MADE_DENSITY = 99.0
PLACE_M = 12.0  # over which roughness and noise vary
PIXEL_M, ACROSS_M, SEED = 0.2, 0.3, 77
MOST_FAIL, MOST_CLOSED = 0.3, 0.02
"""p_fail of the tiles that are driven, and share of the pixels within 1.5 m of a line that may be closed or unknown."""


def tiles_of(layers):
    """Return the tiles of a map by column and row, with the code of what bars each."""
    tiles = bumpymap.open(layers).tiles().set_index(["col", "row"])
    return tiles.assign(code=[TEXTS.get(text, Barred.NO) for text in tiles["barred"]])


def write_copy(survey, path, seed, *, share=1.0, noise=0.0, ground=False):
    """Write a random share of the points of a survey."""
    points, rng = laspy.read(survey), np.random.default_rng(seed)
    points.points = points.points[rng.random(len(points.points)) < share]
    points.z = np.asarray(points.z) + noise * rng.standard_normal(len(points.points))
    if ground:
        points.classification = np.full(len(points.points), 2, np.uint8)
    points.write(path)


def compare_passable(first, after):
    """Return the cells of what a copy bars and opens."""
    codes = after["code"].reindex(first.index, fill_value=Barred.UNKNOWN).to_numpy()
    before = first["code"].to_numpy()
    passable = codes[before == Barred.NO]
    was_closed = ~np.isin(before, (Barred.NO, *CROSSING_UNKNOWN))
    closed, opened = before[was_closed], before[was_closed & (codes == Barred.NO)]
    cells = [_share(passable != Barred.NO), _reasons(passable[passable != Barred.NO], passable)]
    return [*cells, _share(codes[was_closed] == Barred.NO), _reasons(opened, closed)]


def _share(marked):
    return f"{100 * np.mean(marked):.1f} % of {len(marked)}"


def _reasons(codes, of):
    counts = np.bincount(codes, minlength=len(Barred))
    return ", ".join(f"{BARRED_TEXT[Barred(code)]} {100 * n / len(of):.1f} %" for code, n in enumerate(counts) if n)


def print_maps(given):
    """Map, compare, print a line for each density."""
    seed = 1 if given.seed is None else given.seed
    settings = {} if given.crs is None else {"crs": given.crs}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)

        def mapped(name, seed, **options):
            write_copy(given.survey, work / "copy.las", seed, ground=given.ground, **options)
            bumpymap.map_survey(work / "copy.las", work / name, **settings)
            return tiles_of(work / name)

        dense = mapped("dense", 0)
        density = dense["density"].mean()
        print("| points/m2 | passable tiles that it bars | by reason | barred tiles that it opens | by reason before |")
        print("|---|---|---|---|---|")
        for wanted in given.densities or (10.0, 6.0):
            for noise in map(float, given.noise.split(",")):
                after = mapped(f"at_{wanted:g}_{noise:g}", seed, share=wanted / density, noise=noise)
                print("| " + " | ".join([f"{wanted:g}", *compare_passable(dense, after)]) + " |", flush=True)


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


def compared_rides(wanted, found, known):
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


def print_rides(given):
    """Print a line for each density."""
    calibration, noise = given.calibration or Calibration.shipped(given.vehicle), float(given.noise)
    seed = 3 if given.seed is None else given.seed
    model, truth = RideModel(calibration), None
    if given.survey in MADE:
        ground, points = made(given.survey, seed)
        truth = true_ride(ground, model)
    else:
        read = laspy.read(given.survey)
        points = np.stack([np.asarray(axis, np.float64) for axis in (read.x, read.y, read.z)])
    rng = np.random.default_rng([seed, 1])
    points[2] += noise * rng.standard_normal(points.shape[1])
    size = calibration.tile_size
    corner = np.floor(points[:2].min(axis=1) / size).astype(int)
    cols, rows = np.floor(points[:2].max(axis=1) / size).astype(int) - corner + 1
    dense = ride_of(points, model, corner, (rows, cols))
    density = points.shape[1] / (np.isfinite(dense[0]).sum() * size**2)
    print("| points/m2 | against | tiles | rank | median error | ratio by third | interval, by third | all | median |")
    print("|---|---|---|---|---|---|---|---|---|")
    judged = np.isfinite(dense[0]) & (dense[3] < 0.5)
    if truth is not None:
        print("| " + " | ".join([f"{density:.0f}", "truth", *compared_rides(truth, dense, judged)]) + " |")
    for wanted in given.densities or (25.0, 10.0, 4.0, 2.0):
        kept = rng.random(points.shape[1]) < wanted / density
        found = ride_of(points[:, kept], model, corner, (rows, cols))
        known = judged & np.isfinite(found[0])
        for name, other in (("all points", dense[0]), ("truth", truth)):
            if other is not None:
                print("| " + " | ".join([f"{wanted:g}", name, *compared_rides(other, found, known)]) + " |", flush=True)


@dataclass
class Ground:
    """Ground of pixels, south row first, [m], from its south-west corner: what is driven has single precision."""

    heights: np.ndarray
    spacing: float = PIXEL_M / 2
    gradient: tuple = (0.0, 0.0)

    def height(self, easting, northing):
        """Return heights of points, m."""
        at = [northing / PIXEL_M - 0.5, easting / PIXEL_M - 0.5]
        return map_coordinates(self.heights, at, order=1, mode="nearest")


def corner_of(site):
    """Return easting and northing of the south-west corner of a map's window, m."""
    return site.grid.tile_size * np.array([site.window.col, site.window.row], np.float64)


def mapped_ground(layers):
    """Return the ground of a map, which of its pixels are not driven, and its south-west corner."""
    site = open_map(layers)
    heights, objects = site.heights(site.window).astype(np.float64), site.objects(site.window)
    heights[(objects == OBSTACLE) | (objects == CANOPY)] = np.nan
    fails = site.values(site.window, ("p_fail",))["p_fail"]
    closed = ~np.isfinite(heights) | ~np.kron(fails < MOST_FAIL, np.ones((site.grid.pixels,) * 2, bool))
    nearest = distance_transform_edt(~np.isfinite(heights), return_distances=False, return_indices=True)
    return Ground(heights[tuple(nearest)][::-1]), closed[::-1], corner_of(site)


def made_ground(kind, path, seed):
    """Write a survey of made-up ground and return this."""
    fine, points = made(kind, seed)
    per = round(PIXEL_M / STEP)
    side = len(fine) // per
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales = [0.001] * 3
    las.x, las.y, las.z = points
    las.classification = np.full(points.shape[1], 2, np.uint8)
    las.write(path)
    return Ground(fine.reshape(side, per, side, per).mean(axis=(1, 3))), np.zeros((side, side), bool), np.zeros(2)


def draw_lines(closed, count, length):
    """Draw starts and headings of lines that can be driven, (count, 3)."""
    rng, near, drawn = np.random.default_rng(SEED), uniform_filter(closed.astype(float), 15), []
    size = PIXEL_M * np.array(closed.shape[::-1])
    along = np.arange(-1.0, length + 1.0, PIXEL_M)
    while len(drawn) < count:
        place, heading = rng.uniform(0.0, size), rng.uniform(0.0, 2.0 * math.pi)
        way = place + along[:, None] * [math.cos(heading), math.sin(heading)]
        if (way > 3.0).all() and (way < size - 3.0).all():
            col, row = (way / PIXEL_M).astype(int).T
            if near[row, col].max() < MOST_CLOSED:
                drawn.append((*place, heading))
    return np.array(drawn)


def drive(ground, profile, engine, line):
    """Return C_r of a drive beside a line, rad/m; NaN if it fails."""
    easting, northing, heading, beside = line
    settings = DriveSettings()
    start = Start(easting - beside * math.sin(heading), northing + beside * math.cos(heading), heading)
    strip = drive_strip(profile, start, settings)
    physics = settings.physics
    vehicle = (
        DartVehicle(profile, ground, strip, physics) if engine == "dart" else SecondVehicle(profile, ground, strip)
    )
    return follow(vehicle, strip, profile, settings).c_r


def predicted(layers, lines, corner, first, last):
    """Return C_r and its 80 % interval of the line, and the mean of the tiles that it crosses, (n, 4) rad/m."""
    site, found = open_map(layers), []
    grid, tiles = site.grid, site.values(site.window, ("c_r",))["c_r"][::-1]
    for easting, northing, heading in lines:
        way = corner + [easting, northing] + np.array([[first], [last]]) * [math.cos(heading), math.sin(heading)]
        ride = bumpymap.ride_along(layers, np.column_stack(site.to_crs(*way.T)))
        at = (np.linspace(*way, 50) - corner_of(site)) // grid.tile_size
        found.append([*ride.over(0.0, math.inf), np.nanmean(tiles[tuple(at.astype(int).T[::-1])])])
    return np.array(found)


def compared_lines(driven, c_r, low, high):
    """Return the cells of a comparison; of tiles, which have no interval of a line, without a share."""
    known = np.isfinite(driven) & np.isfinite(c_r)
    wanted, ratio = driven[known], c_r[known] / driven[known]
    third = np.searchsorted(np.quantile(wanted, [1 / 3, 2 / 3]), wanted)
    cells = [f"{known.sum()}", f"{spearmanr(wanted, c_r[known]).statistic:.3f}"]
    cells += [
        f"{100 * np.median(abs(np.log(ratio))):.0f} %",
        *(f"{np.median(ratio[third == k]):.2f}" for k in range(3)),
    ]
    return [*cells, "" if low is None else f"{np.mean((wanted >= low[known]) & (wanted <= high[known])):.2f}"]


def print_lines(given):
    """Map, drive, print two lines for each density."""
    settings, profile = DriveSettings(), Calibration.shipped(given.vehicle).profile
    first = profile.speed_mps * (settings.ramp_s / 2 + settings.cruise_s)
    last = first + profile.speed_mps * settings.measure_s
    with tempfile.TemporaryDirectory() as folder:
        whole, copy = Path(folder) / "whole.laz", Path(folder) / "copy.laz"
        mapped = partial(bumpymap.map_survey, crs=given.crs or "EPSG:25832", vehicle=given.vehicle)
        if given.survey in MADE:
            ground, closed, corner = made_ground(given.survey, whole, 3)
            density = MADE_DENSITY
        else:
            whole = Path(given.survey)
            mapped(whole, out=f"{folder}/whole")
            ground, closed, corner = mapped_ground(f"{folder}/whole")
            density = float(np.nanmedian(bumpymap.open(f"{folder}/whole").tiles()["density"]))
        lines = draw_lines(closed, given.lines, last)
        beside = ACROSS_M * np.random.default_rng(SEED).standard_normal(len(lines))
        with Pool() as pool:
            jobs = np.column_stack([lines, beside])
            driven = np.array(pool.map(partial(drive, ground, profile, given.engine), jobs, chunksize=4))
        print("| points/m² | by | lines | Spearman | median error | ratio, smooth third | middle | rough | inside |")
        print("|---|---|---|---|---|---|---|---|---|")
        for wanted in given.densities or (density,):
            write_copy(whole, copy, SEED, share=min(1.0, wanted / density), noise=float(given.noise))
            mapped(copy, out=f"{folder}/{wanted:g}")
            c_r, low, high, tiles = predicted(f"{folder}/{wanted:g}", lines, corner, first, last).T
            print("|", " | ".join([f"{wanted:.0f}", "tiles", *compared_lines(driven, tiles, None, None)]), "|")
            print("|", " | ".join([f"{wanted:.0f}", "line", *compared_lines(driven, c_r, low, high)]), "|", flush=True)


def main():
    """Print the table that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tables = {"maps": print_maps, "ride": print_rides, "lines": print_lines}
    parser.add_argument("table", choices=tables)
    parser.add_argument("survey")
    parser.add_argument("--crs")
    parser.add_argument("--densities", type=lambda text: tuple(map(float, text.split(","))), help="points per m2")
    parser.add_argument("--noise", default="0", help="standard deviation of errors, m; of maps, several by commas")
    parser.add_argument("--seed", type=int, help="of maps (1) and ride (3)")
    parser.add_argument("--ground", action="store_true", help="maps: call all points ground")
    parser.add_argument("--lines", type=int, default=120)
    parser.add_argument("--engine", choices=("dart", "mujoco"), default="dart")
    parser.add_argument("--vehicle", default="warthog")
    parser.add_argument("--calibration", type=Calibration.load, help="of the ride; that of the vehicle")
    given = parser.parse_args()
    tables[given.table](given)


if __name__ == "__main__":
    main()
