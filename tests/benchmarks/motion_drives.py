"""Drive over patches of a survey at several speeds and hold pitch, roll and weighted acceleration against the map.

    python tests/benchmarks/motion_drives.py SURVEY --crs EPSG:CODE --data FOLDER

Patches are chosen as by ``bumpymap evaluate``: as many for each level of roughness. Every start is driven at every
speed. Drives are recorded in FOLDER, and are not repeated by the next call. They run over the measured ground with its
noise, which the map takes off; ``--raw`` rates that ground.
"""

import argparse
import math
from functools import partial
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from bumpymap.core import FeatureSettings, Georeference, Reason, SilentProgress, TextureMap
from bumpymap.lab.evaluate.rated_survey import NoisyRide, load_survey, open_readers, take_tiles
from bumpymap.lab.evaluate.survey_trial import choose_patches, driven_ground, strata, uniform_by_key
from bumpymap.lab.simulate.drive import Start
from bumpymap.lab.simulate.jobs import JobJournal, drive_jobs
from bumpymap.lab.simulate.motion_fit import MotionRecord, drive_motion
from bumpymap.lab.simulate.terrain import PatchGround
from bumpymap.patches import join_stacks
from bumpymap.rating import QUANTITIES, RideModel, Vehicle, find_calibration, motion_felt
from bumpymap.readers import ReadOptions
from bumpytiles import Grid


class Job:
    """Drives over one patch."""

    def __init__(self, key, heights, starts):
        self.key, self.heights, self.starts = key, heights, starts


def drive_patch(profile, tile_size, speeds, starts, seed, job):
    """Drive over a patch from random starts, each at every speed."""
    ground = PatchGround.from_heights(job.heights, tile_size)
    made = []
    for number in range(starts):
        rng = np.random.default_rng([seed, number, *(abs(part) for part in job.key)])
        easting, northing, turn = rng.random(3).tolist()
        start = Start(easting * ground.extent, northing * ground.extent, turn * 2 * math.pi)
        made.append([drive_motion(profile, ground, start, speed) for speed in speeds])
    return MotionRecord.of(made)


def survey_patches(args, grid, features):
    """Measure the survey and return its patches that can be judged."""
    readers = open_readers([args.survey], ReadOptions(crs=args.crs), local=args.crs is None)
    with load_survey(readers, "auto", grid, features, args.data, SilentProgress()) as survey:
        stacks = [survey.measured(points) for points in survey.points()]
    return join_stacks([take_tiles(stack, stack.reason == Reason.OK) for stack in stacks])


def driven_means(record):
    """Return mean and its relative standard error, (quantities, speeds): NaN where a quarter of the drives failed."""
    found = np.array([getattr(record, name) for name in QUANTITIES], dtype=float)
    done = np.isfinite(found).sum(axis=1)
    found = np.where((done >= 0.75 * found.shape[1])[:, None], found, np.nan)
    mean = np.where(np.isfinite(found).any(axis=1), np.nansum(found, axis=1) / np.maximum(done, 1), np.nan)
    return mean, np.nanstd(found, axis=1, ddof=1) / np.sqrt(done) / mean


def arguments():
    """Return what was given on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("survey", type=Path)
    parser.add_argument("--crs")
    parser.add_argument("--data", type=Path, required=True, help="folder for the record of the drives")
    parser.add_argument("--vehicle", default="warthog")
    parser.add_argument("--patches", type=int, default=60)
    parser.add_argument("--starts", type=int, default=8)
    parser.add_argument("--speeds", default="0.5,1,2")
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--raw", action="store_true", help="rate the ground with its noise")
    parser.add_argument("--jobs", type=int, default=1)
    return parser.parse_args()


def chosen_patches(args, patches, model):
    """Return patches of all levels of roughness that few drives fail on."""
    rated = model.rate(patches, TextureMap.unknown(len(patches.reason)), Georeference(None))
    stratum = strata(rated.c_r.astype(float), rated.p_fail.astype(float))
    crossed = np.flatnonzero(rated.p_fail < 0.2)
    priority = uniform_by_key(args.seed, patches.col[crossed], patches.row[crossed])
    return take_tiles(patches, crossed[choose_patches(stratum[crossed], priority, args.patches)])


def driven_patches(args, profile, speeds, chosen):
    """Drive over patches; return means and their errors, (patches, quantities, speeds) each."""
    names = list(zip(chosen.col.tolist(), chosen.row.tolist(), strict=True))
    ground = driven_ground(chosen)
    jobs = [Job(name, heights, args.starts * len(speeds)) for name, heights in zip(names, ground, strict=True)]
    settings = {"vehicle": profile.to_dict(), "speeds": speeds, "starts": args.starts, "seed": args.seed}
    driven = drive_jobs(
        partial(drive_patch, profile, chosen.grid.tile_size, speeds, args.starts, args.seed),
        jobs,
        lambda done, every: (args.data / "progress").write_text(f"{done}/{every}\n"),
        workers=args.jobs,
        journal=JobJournal(args.data / f"motion-{args.vehicle}.jsonl", settings, MotionRecord.read),
    )
    return tuple(np.stack(part) for part in zip(*(driven_means(driven[name]) for name in names), strict=True))


def show(felt, means, errors, speeds):
    """Print a line for each quantity and speed."""
    print(f"{'':8s} {'m/s':>5s} {'n':>4s} {'Spearman':>9s} {'median error':>13s} {'bias':>7s} {'driven error':>13s}")
    for q, name in enumerate(QUANTITIES):
        for v, speed in enumerate(speeds):
            known = np.isfinite(means[:, q, v])
            ratio = np.log(felt[known, v, q] / means[known, q, v])
            rank = spearmanr(felt[known, v, q], means[known, q, v]).statistic
            shares = [np.expm1(np.median(np.abs(ratio))), np.expm1(np.median(ratio)), np.median(errors[known, q, v])]
            print(f"{name:8s} {speed:5g} {known.sum():4d} {rank:9.3f} " + " ".join(f"{x:12.1%}" for x in shares))


def main():
    """Drive, compare, print a table."""
    args = arguments()
    args.data.mkdir(parents=True, exist_ok=True)
    speeds = tuple(float(word) for word in args.speeds.split(","))
    calibration = find_calibration(args.vehicle).without_floor()  # simulated drives have none
    profile = Vehicle.from_dict(calibration.vehicle, args.vehicle)
    grid = Grid(calibration.tile_size, calibration.pixels)
    model = RideModel(calibration, speeds)
    chosen = chosen_patches(args, survey_patches(args, grid, FeatureSettings()), model)
    model = NoisyRide(calibration, speeds) if args.raw else model
    rated = model.rate(chosen, TextureMap.unknown(len(chosen.reason)), Georeference(None))
    felt = (
        motion_felt(calibration, speeds, rated.motion, rated.c_r)
        .reshape(-1, len(speeds), len(QUANTITIES))
        .astype(float)
    )
    means, errors = driven_patches(args, profile, speeds, chosen)
    print(f"{len(felt)} patches, {args.starts} starts each; median standard error of the driven means beside")
    show(felt, means, errors, speeds)


if __name__ == "__main__":
    main()
