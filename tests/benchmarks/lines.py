"""Drive along lines of 10 m over a survey's ground, and hold the rides against those that maps of it predict.

    python tests/benchmarks/lines.py SURVEY|meadow|site [--crs CRS] [--densities 99,25] [--noise 0] [--lines 120]
        [--engine dart|mujoco] [--vehicle warthog]

The ground driven is that of the map of the survey as it is, away from obstacles and steep tiles, or the made-up one of
thinned_ride.py. Mapped are copies with fewer points and with errors of their heights [m]. Each line is driven once,
beside its own place by an error of 0.3 m (standard deviation), as `ride_along` reckons with. MuJoCo is another engine
(see second_engine.py); DART needs the extra `sim`.
"""

import argparse
import math
import tempfile
from dataclasses import dataclass
from functools import partial
from multiprocessing import Pool
from pathlib import Path

import laspy
import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates, uniform_filter
from scipy.stats import spearmanr
from second_engine import SecondVehicle
from thinned_maps import write_copy
from thinned_ride import MADE, MADE_DENSITY, STEP, made

import bumpymap
from bumpymap.core import CANOPY, OBSTACLE
from bumpymap.lab.settings import DriveSettings
from bumpymap.lab.simulate.drive import Start, drive_strip, follow
from bumpymap.lab.simulate.model import DartVehicle
from bumpymap.layers import open_map
from bumpymap.rating import Calibration

PIXEL_M, ACROSS_M, SEED = 0.2, 0.3, 77
MOST_FAIL, MOST_CLOSED = 0.3, 0.02
"""p_fail of the tiles that are driven, and share of the pixels within 1.5 m of a line that may be closed or unknown."""


@dataclass
class Ground:
    """Ground of pixels, south row first, [m]."""

    heights: np.ndarray
    corner: np.ndarray
    """Easting and northing of its south-west corner, m."""
    spacing: float = PIXEL_M / 2
    gradient: tuple = (0.0, 0.0)

    def height(self, easting, northing):
        """Return heights of points, m."""
        at = [(northing - self.corner[1]) / PIXEL_M - 0.5, (easting - self.corner[0]) / PIXEL_M - 0.5]
        return map_coordinates(self.heights, at, order=1, mode="nearest")


def mapped_ground(layers):
    """Return the ground of a map, and which of its pixels are not driven."""
    site = open_map(layers)
    heights, objects = site.heights(site.window).astype(np.float64), site.objects(site.window)
    heights[(objects == OBSTACLE) | (objects == CANOPY)] = np.nan
    fails = site.values(site.window, ("p_fail",))["p_fail"]
    closed = ~np.isfinite(heights) | ~np.kron(fails < MOST_FAIL, np.ones((site.grid.pixels,) * 2, bool))
    nearest = distance_transform_edt(~np.isfinite(heights), return_distances=False, return_indices=True)
    corner = site.grid.tile_size * np.array([site.window.col, site.window.row], np.float64)
    return Ground(heights[tuple(nearest)][::-1], corner), closed[::-1]


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
    return Ground(fine.reshape(side, per, side, per).mean(axis=(1, 3)), np.zeros(2)), np.zeros((side, side), bool)


def draw_lines(ground, closed, count, length):
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
                drawn.append((*(ground.corner + place), heading))
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


def predicted(layers, lines, first, last):
    """Return C_r and its 80 % interval of the line, and the mean of the tiles that it crosses, (n, 4) rad/m."""
    site, found = open_map(layers), []
    grid, tiles = site.grid, site.values(site.window, ("c_r",))["c_r"][::-1]
    for easting, northing, heading in lines:
        way = [easting, northing] + np.array([[first], [last]]) * [math.cos(heading), math.sin(heading)]
        ride = bumpymap.ride_along(layers, np.column_stack(site.to_crs(*way.T)))
        at = np.linspace(*way, 50) // grid.tile_size - [site.window.col, site.window.row]
        found.append([*ride.over(0.0, math.inf), np.nanmean(tiles[tuple(at.astype(int).T[::-1])])])
    return np.array(found)


def compared(driven, c_r, low, high):
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


def main():
    """Map, drive, print two lines for each density."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("survey")
    parser.add_argument("--crs", default="EPSG:25832")
    parser.add_argument("--densities", help="points per m2; all points if not given")
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--lines", type=int, default=120)
    parser.add_argument("--engine", choices=("dart", "mujoco"), default="dart")
    parser.add_argument("--vehicle", default="warthog")
    given = parser.parse_args()
    settings, profile = DriveSettings(), Calibration.shipped(given.vehicle).profile
    first = profile.speed_mps * (settings.ramp_s / 2 + settings.cruise_s)
    last = first + profile.speed_mps * settings.measure_s
    with tempfile.TemporaryDirectory() as folder:
        whole, copy = Path(folder) / "whole.laz", Path(folder) / "copy.laz"
        mapped = partial(bumpymap.map_survey, crs=given.crs, vehicle=given.vehicle)
        if given.survey in MADE:
            ground, closed = made_ground(given.survey, whole, 3)
            density = MADE_DENSITY
        else:
            whole = Path(given.survey)
            mapped(whole, out=f"{folder}/whole")
            ground, closed = mapped_ground(f"{folder}/whole")
            density = float(np.nanmedian(bumpymap.open(f"{folder}/whole").tiles()["density"]))
        lines = draw_lines(ground, closed, given.lines, last)
        beside = ACROSS_M * np.random.default_rng(SEED).standard_normal(len(lines))
        with Pool() as pool:
            jobs = np.column_stack([lines, beside])
            driven = np.array(pool.map(partial(drive, ground, profile, given.engine), jobs, chunksize=4))
        print("| points/m² | by | lines | Spearman | median error | ratio, smooth third | middle | rough | inside |")
        print("|---|---|---|---|---|---|---|---|---|")
        for wanted in map(float, given.densities.split(",")) if given.densities else (density,):
            write_copy(whole, copy, SEED, share=min(1.0, wanted / density), noise=given.noise)
            mapped(copy, out=f"{folder}/{wanted:g}")
            c_r, low, high, tiles = predicted(f"{folder}/{wanted:g}", lines, first, last).T
            print("|", " | ".join([f"{wanted:.0f}", "tiles", *compared(driven, tiles, None, None)]), "|")
            print("|", " | ".join([f"{wanted:.0f}", "line", *compared(driven, c_r, low, high)]), "|", flush=True)


if __name__ == "__main__":
    main()
