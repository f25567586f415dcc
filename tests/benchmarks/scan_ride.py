"""Compare the ride on the sectors of made-up scans with a map of the same ground, surveyed densely.

python tests/benchmarks/scan_ride.py [--grounds 8] [--vehicle warthog] [--sensors 64_down 32_sparse 16_narrow]

Each ground has hills, bumps, roads, mud or rubble and nothing stands on it. It is scanned from its middle, and surveyed
with 100 points per square metre and 1 cm of noise. A sector's reference is the mean of the map over its area.
"""

import argparse
import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.stats import spearmanr

from bumpymap.core import NO_CLASS, Scan, SectorRide, SectorStack, sector_bounds
from bumpymap.lab.worlds.scans.lidar import SENSORS, Sensor, _World, posture, simulate_scan
from bumpymap.lab.worlds.scans.scene import Scene, make_scene
from bumpymap.rating import find_calibration
from bumpymap.scan import polar_sectors
from bumpymap.scan.methods import SectorRater
from bumpymap.survey import map_survey

THEMES = ("meadow", "mire", "quarry", "bushland")
HALF_M, DENSITY, NOISE_M = 45.0, 100.0, 0.01
HIGH_M = 100.0
SEED = 1
RANGES_M = ((1.0, 4.0), (4.0, 12.0), (12.0, 28.0), (28.0, 60.0))


def bare_ground(number: int) -> Scene:
    """Draw a scene without anything on its ground."""
    scene = make_scene(31, number, THEMES[number % len(THEMES)])
    return replace(scene, things=(), ground=replace(scene.ground, grass_m=0.001), wet=0.0, mirror=0.0)


def survey_ground(scene: Scene, sensor: Sensor, path: Path) -> None:
    """Write a dense survey of the ground, seen from above, in the frame of the sensor.

    It is the mesh that the scan is simulated with.
    """
    rng = np.random.default_rng(7)
    x, y = rng.uniform(-HALF_M, HALF_M, (2, round(DENSITY * 4 * HALF_M**2)))
    start = np.column_stack([x, y, np.full(len(x), HIGH_M)])
    world = _World.of(scene, sensor, np.random.default_rng([*scene.seed, SEED, 1]))
    z = HIGH_M - world.first_hit(start, np.tile([0.0, 0.0, -1.0], (len(x), 1)))["t_hit"].numpy().astype(np.float64)
    eye = float(scene.ground.sample(np.zeros(1), np.zeros(1)).z[0]) + sensor.height_m
    points = np.column_stack([x, y, z - eye]) @ (posture(scene) @ sensor.to_level())
    points[:, 2] += NOISE_M * rng.standard_normal(len(points))
    survey = laspy.LasData(laspy.LasHeader(point_format=0, version="1.2"))
    survey.header.scales = [0.0001] * 3
    survey.x, survey.y, survey.z = points[np.isfinite(z)].T
    survey.write(path)


def surveyed_ride(folder: Path, survey: Path, vehicle: str) -> dict[tuple[int, int], float]:
    """Map the survey; return C_r by column and row of the tile."""
    map_survey(survey, folder, vehicle=vehicle, local=True)
    tiles = pq.read_table(folder / "tiles.parquet", columns=["col", "row", "c_r"]).to_pydict()
    c_r = [math.nan if value is None else value for value in tiles["c_r"]]
    return dict(zip(zip(tiles["col"], tiles["row"], strict=True), c_r, strict=True))


def reference(stack: SectorStack, mapped: dict[tuple[int, int], float], tile_m: float) -> NDArray[np.float64]:
    """Return the mean of the map over each sector; NaN where less than nine tenths of it are mapped."""
    bounds = sector_bounds(stack)
    steps = (np.arange(20) + 0.5) / 20
    found = np.full(len(stack.zone), np.nan)
    for number, (near, far, right, left) in enumerate(
        zip(bounds.near, bounds.far, bounds.right, bounds.left, strict=True)
    ):
        away = np.sqrt(near**2 + steps[:, None] * (far**2 - near**2))
        angle = right + steps * (left - right)
        col, row = np.floor(away * np.cos(angle) / tile_m), np.floor(away * np.sin(angle) / tile_m)
        c_r = np.array([mapped.get(tile, np.nan) for tile in zip(col.ravel(), row.ravel(), strict=True)], float)
        if np.isfinite(c_r).mean() >= 0.9:
            found[number] = np.nanmean(c_r)
    return found


def report(name: str, ride: NDArray[np.float64]) -> None:
    """Print a line for the sectors (n, 6): distance, C_r, low, high, reference, density."""
    if len(ride) < 5:
        print(f"{name:24} {len(ride):6}")
        return
    _, c_r, low, high, truth, _ = ride.T
    error = np.log(c_r / truth)
    inside = ((low <= truth) & (truth <= high)).mean()
    print(
        f"{name:24} {len(ride):6} {np.exp(np.median(error)):6.2f} {np.exp(np.quantile(error, 0.1)):6.2f} "
        f"{np.exp(np.quantile(error, 0.9)):6.2f} {spearmanr(c_r, truth).statistic:9.2f} {inside:9.2f}"
    )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grounds", type=int, default=8)
    parser.add_argument("--vehicle", default="warthog")
    parser.add_argument("--sensors", nargs="+", default=["64_down", "32_sparse", "16_narrow"], choices=SENSORS)
    given = parser.parse_args()
    calibration = find_calibration(given.vehicle)
    rater = SectorRater(calibration)
    print(f"{'':24} {'n':>6} {'median':>6} {'10 %':>6} {'90 %':>6} {'Spearman':>9} {'in 80 %':>9}")
    for name in given.sensors:
        rows, rated, traversable, seconds = [], 0, 0, []
        for number in range(given.grounds):
            scene, sensor = bare_ground(number), SENSORS[name]
            with tempfile.TemporaryDirectory() as folder:
                survey_ground(scene, sensor, Path(folder) / "survey.las")
                mapped = surveyed_ride(Path(folder) / "map", Path(folder) / "survey.las", given.vehicle)
            points = simulate_scan(scene, sensor, SEED).points
            scan = Scan(points[np.abs(points).sum(axis=1) > 0])
            stack = polar_sectors(scan)
            rater(scan, stack)
            begin = time.perf_counter()
            ride: SectorRide = rater(scan, stack)
            seconds.append(time.perf_counter() - begin)
            truth = reference(stack, mapped, calibration.tile_size)
            bounds = sector_bounds(stack)
            asked = (ride.class_id != NO_CLASS) & np.isfinite(truth)
            away = 0.5 * (bounds.near + bounds.far)
            area = 0.5 * (bounds.left - bounds.right) * (bounds.far**2 - bounds.near**2)
            columns = (away, ride.c_r, ride.c_r_low, ride.c_r_high, truth, stack.ground_count / area)
            rows.append(np.column_stack(columns)[asked])
            rated += int((ride.class_id != NO_CLASS).sum())
            traversable += int(stack.traversable.sum())
        found = np.concatenate(rows)
        report(name, found)
        for near, far in RANGES_M:
            report(f"  {near:g} to {far:g} m", found[(found[:, 0] >= near) & (found[:, 0] < far)])
        print(f"  {rated:,} of {traversable:,} sectors rated, {1000 * np.median(seconds):.0f} ms a scan")


if __name__ == "__main__":
    main()
