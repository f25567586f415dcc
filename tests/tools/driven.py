"""Compare the ride costs of a survey with simulated drives over the same ground: the table of docs/pages/benchmarks.md.

    python tests/tools/driven.py SURVEY... [--patches 110] [--drives 16] [--vehicle warthog] [--out report.json]

Patches are taken in equal numbers from ten bins of predicted C_r. C_r is compared where at most a quarter of the drives
failed. The JSON file is what docs/pictures/evaluation_driven.py draws. A drive takes 0.3 s of a core. Needs the
extra `sim`.
"""

import argparse
import json
from dataclasses import replace
from functools import partial
from multiprocessing import Pool
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr
from sklearn.metrics import roc_auc_score
from tables import MeasuredSurvey, number

from bumpymap.core import Reason
from bumpymap.lab.evaluate import percent, table
from bumpymap.lab.settings import DriveSettings
from bumpymap.lab.simulate.drive import drive_patch
from bumpymap.rating import Calibration, RideModel, TextureModel, Vehicle, classify, rate
from bumpymap.readers import ReadOptions
from bumpytiles import Grid

FIELDS, MOST_FAILED, SEED = ("c_r", "c_r_low", "c_r_high", "p_fail", "class_id"), 0.25, 7


def rated(surveys, options, calibration, grid):
    """Return the ground of all tiles that can be rated, (n, pixels, pixels) m, their slope, and their ratings."""
    textures, ride = TextureModel.shipped(), RideModel(calibration)
    survey = MeasuredSurvey(surveys, options, grid)
    ground, slope, found = [], [], {"ride": [], "table": []}
    for patches in survey.measured(survey.buckets.blocks()):
        seen = classify(patches, textures)
        maps = {"ride": ride.rate(patches, seen), "table": rate(patches, seen, calibration)}
        known = patches.reason == Reason.OK
        ground += [on_plane(patches.relief_map[tile], patches.heights[tile]) for tile in np.flatnonzero(known)]
        slope.append(patches.slope[known])
        for name, own in maps.items():
            found[name].append(np.array([getattr(own, field)[known] for field in FIELDS], np.float64))
    ratings = {name: dict(zip(FIELDS, np.concatenate(parts, axis=1), strict=True)) for name, parts in found.items()}
    return np.array(ground), np.concatenate(slope), ratings


def on_plane(relief, heights):
    """Return the relief of a patch, holes filled, on the plane that its heights have, m."""
    axis = np.arange(len(relief)) - (len(relief) - 1) / 2
    terms = np.stack([np.ones(relief.size), *(part.ravel() for part in np.meshgrid(axis, axis))], axis=1)
    plane = (heights.astype(np.float64) - relief).ravel()
    known = np.isfinite(plane)
    (_, *tilt), *_ = np.linalg.lstsq(terms[known], plane[known], rcond=None)
    return relief + (terms[:, 1:] @ tilt).reshape(relief.shape)


def choose(c_r, count):
    """Return rows of as many tiles of each of ten bins of C_r as there are, ``count`` in all."""
    low, high = np.quantile(np.log(c_r), (0.02, 0.98))
    bins = np.clip(np.floor(10 * (np.log(c_r) - low) / max(high - low, 1e-9)), 0, 9)
    mixed = np.random.default_rng(SEED).permutation(len(c_r))
    order = mixed[np.argsort(bins[mixed], kind="stable")]
    turn = np.arange(len(order)) - np.searchsorted(bins[order], bins[order])
    return np.sort(order[np.argsort(turn, kind="stable")][:count])


def drive(profile, tile_size, drives, job):
    number, heights = job
    for starts in (drives, 3 * drives):
        made = drive_patch(profile, heights, tile_size, SEED, starts, DriveSettings(), stream=(number,))
        if made.mean_c_r is None or (made.standard_error or np.inf) <= 0.05 * made.mean_c_r:
            break
    return made.mean_c_r, len(made.completed), made.failed


def compared(own, driven, level, limits):
    """Return the cells of a rating: Spearman, median error, same class, in the interval, AUC of p_fail."""
    c_r, completed, failed = driven
    share = failed / (completed + failed)
    good = (share <= MOST_FAILED) & (c_r > 0)
    true_class = np.where((share >= 0.5) | np.isnan(c_r), len(limits), np.searchsorted(limits, c_r, side="right"))
    held = (own["c_r_low"] <= c_r) & (c_r <= own["c_r_high"])
    labels, weights = np.repeat([1, 0], len(share)), np.concatenate([share, 1 - share])
    some = 0 < failed.sum() < (failed + completed).sum()
    auc = roc_auc_score(labels, np.tile(own["p_fail"], 2), sample_weight=weights) if some else np.nan
    return [
        number(spearmanr(own["c_r"][good], c_r[good]).statistic),
        percent(float(np.median(np.abs(own["c_r"][good] / c_r[good] - 1)))),
        percent(float((own["class_id"] == true_class)[level].mean())),
        percent(float(held[good].mean())),
        number(float(auc)),
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("surveys", nargs="+", type=Path, metavar="SURVEY")
    parser.add_argument("--patches", type=int, default=110)
    parser.add_argument(
        "--drives",
        type=int,
        default=16,
        help="of a patch; three times as many where the mean is off by more than 5 %% (16)",
    )
    parser.add_argument("--vehicle", default="warthog")
    parser.add_argument("--out", type=Path, default=Path("report.json"))
    given = parser.parse_args()
    shipped = Calibration.shipped(given.vehicle)
    vehicle = {key: value for key, value in shipped.vehicle.items() if key != "floor"}  # simulated drives have none
    calibration = replace(shipped, vehicle=vehicle)
    grid = Grid(calibration.tile_size, calibration.pixels)
    profile = Vehicle.from_dict(calibration.vehicle, "calibration")
    options = ReadOptions(pixel_m=grid.pixel_size)
    ground, slope, ratings = rated(given.surveys, options, calibration, grid)
    rows = choose(ratings["ride"]["c_r"], given.patches)
    with Pool() as pool:
        jobs = [(int(row), ground[row]) for row in rows]
        driven = np.array(pool.map(partial(drive, profile, grid.tile_size, given.drives), jobs, chunksize=1), float).T
    level = slope[rows] <= profile.slope_limit_deg
    chosen = {name: {field: values[rows] for field, values in own.items()} for name, own in ratings.items()}
    cells = [[f"`{name}`", *compared(own, driven, level, calibration.class_limits)] for name, own in chosen.items()]
    header = ("predictor", "Spearman", "median error", "same class", "80 % interval holds", "p_fail AUC")
    print("\n".join(table(header, cells)))
    print(f"{len(rows)} patches, {driven[1:].sum():.0f} drives, {driven[2].sum():.0f} failed")
    patches = {
        "driven": dict(zip(("c_r", "completed", "failed"), driven.tolist(), strict=True)),
        "verdicts": {name: {field: own[field].tolist() for field in FIELDS} for name, own in chosen.items()},
    }
    given.out.write_text(json.dumps({"patches": patches}), encoding="utf-8")


if __name__ == "__main__":
    main()
