"""Drive over ditches of many widths and depths, and hold what the map says of surveyed ones against the drives.

    python tests/benchmarks/ditch_drives.py --data FOLDER [--vehicle warthog] [--seed 1]

Each ditch is crossed 8 times, at 0 to 40 degrees from its normal, and driven 8 times as a tile that holds it. Drives
are recorded in FOLDER, and are not repeated by the next call. Then each ditch, and ramps, are laid at six places and
angles through level ground, surveyed at 200 to 4 points per m2, without and with noise of 3 cm, and mapped. Tiles count
whose middle is within 1 m of that of the ditch.
"""

import argparse
import math
import sys
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from bumpymap.core import Barred, Georeference, MapConfig, SilentProgress, rated_columns
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate.drive import Effort, PatchDrives, drive_patch
from bumpymap.lab.simulate.jobs import Journal, drive_jobs
from bumpymap.lab.simulate.refit import WallGround, cross
from bumpymap.rating import Vehicle, crossing_fails
from bumpymap.survey.second_pass import NeighbourRating, finish_tiles
from bumpymap.survey.tile_rating import RatingModels, TileRating
from bumpytiles import Grid, TileBuckets, TileTable

WIDTHS_M = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.2, 1.5)
DEPTHS_M = (0.2, 0.3, 0.4, 0.5, 1.0)
RAMPS_DEG = (0, 10, 20, 24, 28)
DENSITIES = (200, 50, 20, 8, 4)
NOISES_M = (0.0, 0.03)
PLACES = 12
DRIVES = 8
FINE_PIXELS = 60
"""Along a side of a driven tile: 5 cm."""
TILES, MARGIN = 7, 2
"""Tiles along a side of the surveyed ground, and those around the ones that count."""


class Job:
    """Drives over one ditch: across it, or over a tile with it."""

    starts = DRIVES

    def __init__(self, kind, width, depth):
        self.kind, self.width, self.depth = kind, width, depth
        self.key = (kind, repr(width), repr(depth))


def ditch_tile(width, depth, pixels):
    """Return a tile of 3 m with a ditch through its middle, (pixels, pixels) m."""
    edges = np.linspace(-1.5, 1.5, pixels + 1)
    inside = np.clip(edges[1:], -width / 2, width / 2) - np.clip(edges[:-1], -width / 2, width / 2)
    return np.tile(-depth * inside * pixels / 3.0, (pixels, 1))


def run(settings, job):
    """Drive one case; the starts depend on the seed and the case alone."""
    stream = (round(100 * job.width), round(100 * job.depth))
    if job.kind == "tile":
        tile = ditch_tile(job.width, job.depth, FINE_PIXELS)
        return drive_patch(settings.profile, tile, 3.0, settings.seed, Effort.fixed(DRIVES), stream=stream)
    rng = np.random.default_rng([settings.seed, *stream])
    ground = WallGround(-job.depth, settings.profile.wheel.radius_m / 6, job.width)
    angles = np.radians(np.linspace(0.0, 40.0, DRIVES))
    made = [cross(settings, ground, float(angle), rng.random(2)) for angle in angles]
    return PatchDrives(tuple(d.outcome for d in made), tuple(d.c_r if math.isfinite(d.c_r) else None for d in made))


def driven(args):
    """Return the drives by case."""
    settings = CalibrationSettings(Vehicle.load(args.vehicle), seed=args.seed)
    jobs = [Job(kind, width, depth) for depth in DEPTHS_M for width in WIDTHS_M for kind in ("crossing", "tile")]
    journal = Journal(args.data / f"ditches-{args.vehicle}.jsonl", settings.to_dict(), PatchDrives.read)
    return drive_jobs(
        partial(run, settings), jobs, lambda done, all_: print(f"{done}/{all_}", file=sys.stderr), journal=journal
    )


def surveyed(rng, density, noise, shape):
    """Survey level ground with a shape, a function of the distance from a line; return points and distances."""
    side = 3.0 * TILES
    east, north, turn = *rng.uniform(0.4 * side, 0.6 * side, 2), rng.uniform(0.0, math.pi)

    def away(x, y):
        return (x - east) * math.sin(turn) - (y - north) * math.cos(turn)

    x, y = rng.uniform(0.0, side, (2, int(density * side**2)))
    return (x, y, shape(away(x, y)) + rng.normal(0.0, noise, len(x))), away


def mapped(config, models, points):
    """Return what bars tiles, and their C_r, as a map finds them; with their middles."""
    grid = Grid(config.tile_size, config.pixels)
    buckets = TileBuckets(grid)
    buckets.add(*points, np.zeros(len(points[0]), np.bool_))
    rating = TileRating.of(config, models, Georeference(None))
    blocks = [rating(block, False) for block in buckets.blocks()]
    columns = {c.name: np.concatenate([block[c.name] for block in blocks]) for c in rated_columns(grid.pixels)}
    with tempfile.TemporaryDirectory() as folder:
        table = TileTable.of(grid, columns)
        table = finish_tiles(table, NeighbourRating.of(config, models), Path(folder), 1, SilentProgress())
        found = table.read(("barred", "c_r", "class_id"))
    inner = np.all([(found[name] >= MARGIN) & (found[name] < TILES - MARGIN) for name in ("col", "row")], axis=0)
    return {name: values[inner] for name, values in found.items()}


def found_of(config, models, shape, near, seed):
    """Return shares of tiles that a step bars, and that anything bars, and the median C_r near a shape, by density."""
    steps, barred, ride = [], [], []
    for density in DENSITIES:
        states, c_r = [], []
        for number in range(PLACES):
            rng = np.random.default_rng([*seed, density, number])
            points, away = surveyed(rng, density, NOISES_M[number % len(NOISES_M)], shape)
            found = mapped(config, models, points)
            here = near(away(3.0 * found["col"] + 1.5, 3.0 * found["row"] + 1.5))
            states.append(found["barred"][here])
            c_r.append(found["c_r"][here])
        states, c_r = np.concatenate(states), np.concatenate(c_r)
        known = states != Barred.UNKNOWN
        steps.append(np.mean(states[known] == Barred.STEP))
        barred.append(np.mean(states[known] != Barred.NO))
        ride.append(np.nanmedian(c_r))
    return steps, barred, ride


def show_row(config, models, name, failed, driven_c_r, shape, seed):
    """Print a line of a table: what the drives say of a shape, and the map."""
    steps, barred, ride = found_of(config, models, shape, lambda away: np.abs(away) <= 1.0, seed)
    cells = [
        name,
        f"{failed:.2f}",
        *(" / ".join(f"{value:.2f}" for value in part) for part in (steps, barred)),
        driven_c_r,
        " / ".join(f"{value:.3f}" for value in ride),
    ]
    print("| " + " | ".join(cells) + " |", flush=True)


def show_ditches(config, models, drives, seed):
    """Print a line of a table for each ditch, and for walls."""
    print("| depth, width (m) | crossings that fail | barred by a step | barred | C_r driven | C_r of the map |")
    print("|---|---|---|---|---|---|")
    for depth in DEPTHS_M[1:]:
        for width in WIDTHS_M:
            crossings, tiles = (drives[Job(kind, width, depth).key] for kind in ("crossing", "tile"))
            show_row(
                config,
                models,
                f"{depth:g}, {width:g}",
                crossings.failed / DRIVES,
                "-" if tiles.failed > DRIVES // 4 else f"{tiles.mean_c_r:.3f}",
                lambda away, d=depth, w=width: np.where(np.abs(away) < w / 2, -d, 0.0),
                [seed, round(100 * depth), round(100 * width)],
            )
        show_row(
            config,
            models,
            f"{depth:g}, wall",
            float(crossing_fails(np.array(depth), models.calibration)),
            "-",
            lambda away, d=depth: np.where(away > 0.0, d, 0.0),
            [seed, round(100 * depth), 0],
        )


def show_ramps(config, models, seed):
    """Print a line of a table for each ramp: of 1 to 6 m from one level to another."""
    print("| ramp (degrees) | tiles barred by a step |\n|---|---|")
    for degrees in RAMPS_DEG:
        shares = [
            found_of(
                config,
                models,
                lambda away, d=degrees, n=length: np.clip(away, 0.0, n) * math.tan(math.radians(d)),
                lambda away: np.abs(away) < math.inf,
                [seed, degrees, length],
            )[0]
            for length in (1, 2, 6)
        ]
        print(f"| {degrees} | " + " / ".join(f"{value:.3f}" for value in np.mean(shares, axis=0)) + " |", flush=True)


def main():
    """Drive, map, print tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder for the record of the drives")
    parser.add_argument("--vehicle", default="warthog")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    args.data.mkdir(parents=True, exist_ok=True)
    config = MapConfig((args.data / "none.laz",), args.data / "none", vehicle=args.vehicle)
    models = RatingModels.load(config)
    models = replace(models, calibration=models.calibration.without_floor())  # drives have none
    show_ramps(config, models, args.seed)
    show_ditches(config, models, driven(args), args.seed)


if __name__ == "__main__":
    main()
