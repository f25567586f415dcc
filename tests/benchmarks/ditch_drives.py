"""Drive over ditches of many widths and depths, and hold what the map says of surveyed ones against the drives.

    python tests/benchmarks/ditch_drives.py --data FOLDER [--vehicle warthog] [--seed 1] [--only-drives]

Each ditch is crossed 8 times, at 0 to 40 degrees from its normal, and driven 8 times as a tile that holds it. Drives
are recorded in FOLDER, and are not repeated by the next call. Then each ditch is laid at several places and angles
through level ground, surveyed at 200 to 4 points per m2 with noise, and mapped.
"""

import argparse
import math
import sys
from functools import partial
from pathlib import Path

import numpy as np

from bumpymap.lab.simulate.journal import Journal
from bumpymap.lab.simulate.patch import Effort, PatchDrives, drive_patch
from bumpymap.lab.simulate.plan import CalibrationSettings
from bumpymap.lab.simulate.pool import drive_jobs
from bumpymap.lab.simulate.steps import WallGround, cross
from bumpymap.rating import Vehicle

WIDTHS_M = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.2, 1.5)
DEPTHS_M = (0.2, 0.3, 0.4, 0.5, 1.0)
DRIVES = 8
FINE_PIXELS = 60
"""Along a side of a driven tile: 5 cm."""


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
    journal = Journal(args.data / f"ditches-{args.vehicle}.jsonl", settings.to_dict())
    return drive_jobs(
        partial(run, settings), jobs, lambda done, all_: print(f"{done}/{all_}", file=sys.stderr), journal=journal
    )


def main():
    """Drive, map, print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder for the record of the drives")
    parser.add_argument("--vehicle", default="warthog")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    args.data.mkdir(parents=True, exist_ok=True)
    drives = driven(args)
    for depth in DEPTHS_M:
        for width in WIDTHS_M:
            c, t = (drives[Job(kind, width, depth).key] for kind in ("crossing", "tile"))
            print(depth, width, "cross failed", c.failed, "tile failed", t.failed, "tile c_r", t.mean_c_r)


if __name__ == "__main__":
    main()
