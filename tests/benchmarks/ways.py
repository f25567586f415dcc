"""Plan ways between random places of a map, and hold them against a plain search over its pixels, or against drives.

    python tests/benchmarks/ways.py LAYERS [--pairs 40] [--seed 1] [--joined]
    python tests/benchmarks/ways.py LAYERS --drives FOLDER [--pairs 20] [--seed 7] [--repeats 4] [--calibration FILE]

*Search*: places are drawn from all pixels on which the middle of the vehicle can be, at least 20 m apart. The search of
scipy steps over the pixels of passage.tif in eight directions at the cost of their tiles, over a corner between closed
pixels where the vehicle may do so. A way touches if it comes nearer than half the vehicle's width to an obstacle pixel.

*Drives*: places are drawn on passable tiles, 40 to 150 m apart. The vehicle of the layers is driven along the best way
and along the straight line between them, over the heights of the map and with its obstacles as walls. The map predicts
C_r of the ground without the survey's noise, and the drives run over heights that contain it, so C_r is predicted
without the correction for noise too. Drives are kept in FOLDER, and the same command goes on with them.
"""

import argparse
import math
import os
import sys
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from statistics import NormalDist

import numpy as np
import rasterio
from scipy.ndimage import generate_binary_structure, label
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

import bumpymap
from bumpymap.core import OBSTACLE, Barred, corners_join
from bumpymap.lab.evaluate.survey_trial import uniform_by_key
from bumpymap.lab.simulate.drive import DriveSettings
from bumpymap.lab.simulate.jobs import Journal, drive_jobs
from bumpymap.layers import open_map
from bumpymap.rating import RideModel, Vehicle, find_calibration, roll_over
from bumpymap.route import CostSettings
from bumpymap.route.ground import CostGround
from bumpymap.route.measure import measure_way
from bumpymap.route.places import in_window, on_grid
from bumpymap.route.planner import Planner
from bumpytiles import TileWindow

sys.path += [str(Path(__file__).resolve().parents[1] / folder) for folder in ("helpers", "worlds")]
from driven_ways import ReliefGround, WayDrive, drive_way, fill_gaps
from route_oracles import pixel_graph

_LEAST_APART_M = 20.0
_DRIVEN_APART_M = (40.0, 150.0)
_OFFSET_M = 0.1
"""Drives are up to this far beside the way, m: the margin beside the vehicle with which tiles are passable."""
_MOST_SHARED = 0.8
"""Largest share of the best way that may lie in tiles of the straight line; else there is nothing to compare."""
_MOST_TRIED = 5000
_ROOM_TILES = 2
"""Tiles around a way whose heights are read."""
_MANY_POINTS = 10.0
"""Points per pixel; without a correction of noise they have no effect."""


def points_along(line, step=0.02):
    """Return points on a line, (n, 2) m."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.append(np.arange(0.0, along[-1], step), along[-1])
    return np.column_stack([np.interp(at, along, line[:, axis]) for axis in (0, 1)])


def compare_searches(folder, pairs, seed, *, joined):
    """Plan and search between pairs of pixels; print a line for each, and return the counts and ratios of costs."""
    site = open_map(folder)
    with rasterio.open(folder / "rasters/obstacle.tif") as file:
        rows, cols = np.nonzero(file.read(1) == OBSTACLE)
        transform = file.transform
    obstacles = np.column_stack(transform @ (cols + 0.5, rows + 0.5))
    near, pixel, width = cKDTree(obstacles) if len(obstacles) else None, site.grid.pixel_size, site.vehicle.width_m
    tiles = site.read(site.window)
    cost = site.rule.cost(tiles.c_r.astype(np.float64), np.nan_to_num(site.rule.hazard(tiles.p_fail)))
    cost = np.where(
        site.passage(site.window), np.repeat(np.repeat(cost, site.grid.pixels, 0), site.grid.pixels, 1), np.inf
    )
    corners = corners_join(width, site.vehicle.reach_m, pixel)
    pieces = label(np.isfinite(cost), generate_binary_structure(2, 1 + corners))[0]
    graph, number = pixel_graph(cost, pixel, past_corners=corners)
    places, rng = np.argwhere(np.isfinite(cost)), np.random.default_rng(seed)
    found = {"missing": 0, "extra": 0, "touches": 0, "ratios": []}
    for pair in range(pairs):
        while True:
            start, goal = (tuple(map(int, place)) for place in places[rng.integers(len(places), size=2)])
            is_joined = pieces[start] == pieces[goal]
            is_far = np.hypot(*np.subtract(start, goal)) * pixel >= _LEAST_APART_M
            if is_far and (is_joined or not joined):
                break
        ends = [transform @ (col + 0.5, row + 0.5) for row, col in (start, goal)]
        try:
            (route,) = bumpymap.find_routes(folder, *(f"crs:{x!r},{y!r}" for x, y in ends))
        except bumpymap.BadInputError as error:
            found["missing"] += is_joined
            if is_joined:
                print(pair, "MISSING", ends, str(error)[:300], flush=True)
            continue
        if not is_joined:
            found["extra"] += 1
            print(pair, "EXTRA", ends, flush=True)
            continue
        gap = math.inf if near is None else near.query(points_along(np.asarray(route.line)))[0].min()
        best = float(dijkstra(graph, directed=False, indices=number[start])[number[goal]])
        found["touches"] += gap < 0.5 * width
        found["ratios"].append(route.figures.cost_m / best)
        print(
            f"{pair}: {route.figures.length_m:.0f} m, {found['ratios'][-1]:.3f} times the cost of the search, "
            f"nearest obstacle {gap:.2f} m{' TOUCHES' if gap < 0.5 * width else ''}",
            flush=True,
        )
    return found


@dataclass(frozen=True)
class Way:
    """A line, and what the map says of it."""

    line: np.ndarray
    """(n, 2) easting and northing of its corners, m."""
    c_r: float = math.nan
    """rad/m, as the next one."""
    c_r_raw: float = math.nan
    """Without the correction for noise."""
    p_arrives: float = math.nan


def ride_without_correction(model, heights, known):
    """Predict C_r of tiles, (rows, cols) rad/m, from their heights as measured, as if these had no noise.

    ``heights`` (rows * pixels, cols * pixels) in m, NaN where no point fell, are filled tile by tile; ``known``
    (rows, cols) are the tiles to predict, the others become NaN.
    """
    pixels, size = model.calibration.pixels, model.calibration.tile_size
    rows, cols = known.shape
    tiles = heights.reshape(rows, pixels, cols, pixels).swapaxes(1, 2)[known]
    filled = np.stack([fill_gaps(tile) for tile in tiles])
    axis = np.arange(pixels) - (pixels - 1) / 2
    norm = pixels * float(axis @ axis)
    east, south = filled.sum(axis=1) @ axis / norm, filled.sum(axis=2) @ axis / norm
    plane = filled.mean(axis=(1, 2))[:, None, None] + east[:, None, None] * axis + south[:, None, None] * axis[:, None]
    slope = np.degrees(np.arctan(np.hypot(east, south) * pixels / size))
    rides = roll_over((filled - plane).astype(np.float32), model.operator)
    found = model.correction.predict(rides, slope, np.zeros(len(tiles)), np.full(len(tiles), _MANY_POINTS))
    out = np.full(known.shape, math.nan)
    out[known] = np.exp(found.log_c_r)
    return out


class WayTrial:
    """Ways over a map, and drives along them.

    Parameters
    ----------
    site : MapReader
    calibration : Calibration
        The one that the map was made with; its vehicle has no floor, as drives have none.
    """

    def __init__(self, site, calibration):
        if calibration.floor:
            raise SystemExit(f"{site.vehicle.name} has a floor of C_r, which drives have not; map with another vehicle")
        self.site, self.calibration = site, calibration
        self.ground = CostGround(site, CostSettings(), site.window.cols * site.window.rows)
        self.profile = Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}")
        self.tiles = site.read(site.window)

    def tiles_under(self, line):
        """Return row and column in the map of points 2 cm apart on a line."""
        return tuple(np.floor(in_window(points_along(line), self.site.grid, self.site.window)).astype(np.int64).T)

    def choose(self, pairs, seed, apart_m=_DRIVEN_APART_M):
        """Yield pairs of the best way and the straight line between random passable tiles that are joined.

        A pair is kept if C_r is known along all of the straight line, which may cross barred ground, and if the best
        way is another one.
        """
        tiles, planner = self.tiles, Planner(self.ground)
        passable = (tiles.barred == Barred.NO) & np.isfinite(tiles.c_r)
        part, places = label(passable)[0], np.argwhere(passable)
        rng, found = np.random.default_rng(seed), 0
        for _ in range(_MOST_TRIED):
            first, second = places[rng.integers(len(places), size=2)]
            metres = float(np.hypot(*(second - first))) * self.site.grid.tile_size
            if not apart_m[0] <= metres <= apart_m[1] or part[tuple(first)] != part[tuple(second)]:
                continue
            straight = on_grid(np.stack([first, second]) + 0.5, self.site.grid, self.site.window)
            if not np.isfinite(tiles.c_r[self.tiles_under(straight)]).all():
                continue
            best = planner.line(*straight)
            if best is None or self._shared(best, straight) > _MOST_SHARED:
                continue
            found += 1
            yield self._predicted(best), Way(straight)
            if found == pairs:
                return
        if not found:
            raise SystemExit("the map has no two passable tiles so far apart with a way other than the straight line")

    def _shared(self, line, other):
        crossed = set(zip(*(at.tolist() for at in self.tiles_under(other)), strict=True))
        return np.mean([tile in crossed for tile in zip(*(at.tolist() for at in self.tiles_under(line)), strict=True)])

    def _predicted(self, line):
        figures = measure_way(self.ground, line, line[[0, -1]]).figures
        window, _ = self._around(line)
        row, col = np.floor(in_window(points_along(line), self.site.grid, window)).astype(np.int64).T
        known = np.zeros((window.rows, window.cols), bool)
        known[row, col] = np.isfinite(self.tiles.c_r[self.tiles_under(line)])
        raw = ride_without_correction(RideModel(self.calibration), self.site.heights(window), known)
        return Way(line, figures.c_r_mean, float(np.nanmean(raw[row, col])), figures.p_arrives)

    def _around(self, line):
        """Return the window around a line, and the line from its south-west corner, (n, 2) m."""
        size = self.site.grid.tile_size
        low = np.floor(line.min(axis=0) / size).astype(int) - _ROOM_TILES
        high = np.ceil(line.max(axis=0) / size).astype(int) + _ROOM_TILES
        return TileWindow(*low.tolist(), *(high - low).tolist()), line - low * size

    def run(self, job):
        """Read the heights around a way and drive along it."""
        window, corners = self._around(job.line)
        heights, objects = self.site.heights(window), self.site.objects(window)
        ground = ReliefGround.from_heightmap(heights, self.site.grid.pixel_size, objects)
        return drive_way(self.profile, ground, corners, job.offset)

    def drive(self, pairs, repeats, seed, folder, workers=1):
        """Drive along both ways of every pair, ``repeats`` times each: number of the pair, name, repeat -> drive."""
        jobs = [
            Job(
                (number, name, repeat),
                way.line,
                _OFFSET_M * float(2 * uniform_by_key(seed, np.array([number]), np.array([repeat]))[0] - 1),
            )
            for number, pair in enumerate(pairs)
            for name, way in zip(("best", "straight"), pair, strict=True)
            for repeat in range(repeats)
        ]
        record = {
            "vehicle": self.profile.to_dict(),
            "files": {file["path"]: file["sha256"] for file in self.site.manifest["files"]},
            "lines": [[way.line.round(6).tolist() for way in pair] for pair in pairs],
            "seed": seed,
            "drive": asdict(DriveSettings()),
            "versions": {name: version(name) for name in ("dartpy", "numpy")},
        }
        journal = Journal(folder / f"ways-{self.profile.name}.jsonl", record, lambda fields: WayDrive(**fields))
        return drive_jobs(partial(WayTrial.run, self), jobs, workers=workers, journal=journal)


@dataclass(frozen=True)
class Job:
    """One drive along one way."""

    key: tuple
    line: np.ndarray
    offset: float
    """m to the left."""
    starts: int = 1


def wilson(successes, trials):
    """Return the 95 % interval of a share by E. B. Wilson (1927), 0..1."""
    share, normal = successes / trials, NormalDist().inv_cdf(0.975)
    square = normal**2
    middle = (share + square / (2 * trials)) / (1 + square / trials)
    half = normal / (1 + square / trials) * math.sqrt(share * (1 - share) / trials + square / (4 * trials**2))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def figures_of(pairs, driven):
    """Return what the page "Routes" shows of ways and their drives.

    Drives along one way are alike, so each way counts as one trial of the interval.
    """

    def arrived(name):
        shares = []
        for number in range(len(pairs)):
            drives = [made for key, made in driven.items() if key[:2] == (number, name)]
            shares.append(np.mean([made.outcome == "completed" for made in drives]))
        return shares

    errors, raw = [], []
    for number, (best, _) in enumerate(pairs):
        drives = [made for key, made in driven.items() if key[:2] == (number, "best")]
        done = [made.c_r for made in drives if made.outcome == "completed"]
        if done:
            errors.append(abs(best.c_r / np.mean(done) - 1.0))
            raw.append(abs(best.c_r_raw / np.mean(done) - 1.0))
    shares = arrived("best")
    return {
        "ways": len(pairs),
        "drives": sum(key[1] == "best" for key in driven),
        "median error of C_r": float(np.median(errors)) if errors else math.nan,
        "without the correction for noise": float(np.median(raw)) if raw else math.nan,
        "P(arrives)": float(np.mean([best.p_arrives for best, _ in pairs])),
        "arrived": float(np.mean(shares)),
        "95 % interval": wilson(math.fsum(shares), len(shares)),
        "arrived on straight lines": float(np.mean(arrived("straight"))),
    }


def main():
    """Plan, compare or drive, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("layers", type=Path)
    parser.add_argument("--pairs", type=int)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--joined", action="store_true", help="draw only pairs with a way between them over pixels")
    parser.add_argument("--drives", type=Path, metavar="FOLDER", help="drive along the ways, and keep the drives there")
    parser.add_argument("--repeats", type=int, default=4, help="drives along each way, each a little beside it")
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    if given.drives is None:
        pairs = given.pairs or 40
        found = compare_searches(given.layers, pairs, 1 if given.seed is None else given.seed, joined=given.joined)
        ratios = found.pop("ratios")
        print(f"{pairs} pairs, {len(ratios)} with a way over pixels; {found}; cost beside the search: ", end="")
        print(f"median {np.median(ratios):.3f}, most {max(ratios):.3f}" if ratios else "no way")
        return
    given.drives.mkdir(parents=True, exist_ok=True)
    site, seed = open_map(given.layers), 7 if given.seed is None else given.seed
    trial = WayTrial(site, find_calibration(site.vehicle.name, given.calibration))
    pairs = list(trial.choose(given.pairs or 20, seed))
    for name, value in figures_of(pairs, trial.drive(pairs, given.repeats, seed, given.drives, given.jobs)).items():
        print(f"{name}: {' to '.join(f'{end:.3g}' for end in np.atleast_1d(value))}")


if __name__ == "__main__":
    main()
