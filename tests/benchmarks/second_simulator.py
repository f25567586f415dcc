"""Drive the terrain library in a second physics engine, MuJoCo, and compare its C_r with that of the calibration.

pip install mujoco
python tests/benchmarks/second_simulator.py [--vehicle warthog] [--each 4] [--starts 8] [--setups soft slippery]

How far two simulations of the same vehicle differ says how much an interval must hold that rests on one of them. The
model here is another one: wheels of their true width, tyres that give way, motors of finite stiffness, ground as a
height field and soft contacts, where the calibration has rigid spheres on a mesh. Starts, headings, speed and steering
are those of the calibration, so that chance does not add to the difference. C_r is compared on terrains where at most a
quarter of the drives fail in either. Needs neither DART nor a display.

FILE of --out gets one line of JSON per terrain; a run with the same FILE goes on where it was stopped.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
from _mujoco_vehicle import SETUPS, MujocoVehicle, Setup
from numpy.typing import NDArray

from bumpymap.lab.simulate.drive import DriveSettings, Outcome, PatchDrives, follow
from bumpymap.lab.simulate.model import Physics
from bumpymap.lab.simulate.plan import read_library
from bumpymap.lab.simulate.ride_fit import relief_and_slope
from bumpymap.lab.simulate.terrain import PatchGround, Strip
from bumpymap.lab.worlds.terrains import KINDS
from bumpymap.rating import MAX_FAILED_SHARE, Calibration, RideModel, Vehicle, roll_over

_NORMAL_TAIL = NormalDist().inv_cdf(0.9)
_LIBRARY_STREAM = 4
_WITHOUT_NOISE = 1e3

Predictions = dict[tuple[str, int], tuple[float, float, float]]


def drive_terrain(profile: Vehicle, heights: NDArray[np.float64], seeds: list[int], setup: Setup) -> PatchDrives:
    """Drive over a terrain (pixels, pixels) [m] of 3 m from the starts that the seeds give."""
    ground = PatchGround.from_heights(heights, 3.0)
    settings = DriveSettings(physics=Physics(setup.time_step, setup.friction))
    outcome: list[Outcome] = []
    c_r: list[float | None] = []
    for seed in seeds:
        easting, northing, turn = np.random.default_rng(seed).random(3).tolist()
        length = profile.speed_mps * (settings.ramp_s / 2 + settings.cruise_s + settings.measure_s)
        half = profile.wheelbase_m / 2 + profile.track_m / 2 + profile.wheel.radius_m + settings.margin_m
        strip = Strip(easting * ground.extent, northing * ground.extent, turn * 2 * math.pi, length, half)
        made = follow(MujocoVehicle(profile, ground, strip, setup), strip, profile, seed, settings)
        outcome.append(made.outcome)
        c_r.append(made.c_r if made.outcome == "completed" else None)
    return PatchDrives(tuple(outcome), tuple(c_r))


def compare(
    calibration: Calibration, each: int, starts: int, setup: Setup, done: set[tuple[str, int]]
) -> Iterator[dict[str, Any]]:
    """Drive ``each`` terrains of every kind, but those that are done; yield a record of both C_r for each."""
    profile = Vehicle.from_dict(calibration.vehicle, calibration.id)
    terrains, driven = read_library(calibration)
    # The first of all kinds, then the second: an interrupted run has seen all kinds.
    for number in sorted(range(len(driven)), key=lambda n: driven[n].index):
        first = driven[number]
        if first.index >= each or (first.kind, first.index) in done:
            continue
        stream = (_LIBRARY_STREAM, KINDS.index(first.kind), first.index)
        seed = calibration.settings["seed"]
        draws = [np.random.SeedSequence(seed, spawn_key=(*stream, k)) for k in range(starts)]  # as `drive_patch`
        seeds = [int(draw.generate_state(1, np.uint64)[0]) for draw in draws]
        second = drive_terrain(profile, terrains[number].heights, seeds, setup)
        yield {
            "kind": first.kind,
            "index": first.index,
            "first": first.c_r,
            "first_error": first.c_r_error,
            "first_failed": first.failed / first.drives,
            "second": second.mean_c_r,
            "second_failed": second.failed / starts,
            "drives": second.c_r,
        }


def predict(calibration: Calibration) -> Predictions:
    """Return C_r [rad/m] of the terrains by the ride model, and the deviations of its logarithm below and above."""
    terrains, driven = read_library(calibration)
    relief, slope = relief_and_slope(terrains)
    model, nothing = RideModel(calibration), np.zeros(len(terrains))
    found = model.correction.predict(roll_over(relief, model.operator), slope, nothing, nothing + _WITHOUT_NOISE)
    rows = zip(np.exp(found.log_c_r).tolist(), found.below.tolist(), found.above.tolist(), strict=True)
    return {(terrain.kind, terrain.index): row for terrain, row in zip(driven, rows, strict=True)}


def summary(records: list[dict[str, Any]], predictions: Predictions) -> dict[str, float]:
    """Return how the two simulations differ, and how well the ride model's intervals hold the second one's means."""
    good = [r for r in records if r["first"] and r["second"]]
    good = [r for r in good if max(r["first_failed"], r["second_failed"]) <= MAX_FAILED_SHARE]
    if not good:
        return {"terrains": 0}
    first, second, error = (np.array([r[key] for r in good]) for key in ("first", "second", "first_error"))
    predicted, below, above = np.array([predictions[r["kind"], r["index"]] for r in good]).T
    apart, away = np.log(second / first), np.log(second / predicted)
    # Of a mean of few drives: both have the same starts.
    drawn = error / first
    inside = (away > -_NORMAL_TAIL * np.hypot(below, drawn)) & (away < _NORMAL_TAIL * np.hypot(above, drawn))
    return {
        "terrains": len(good),
        "median_ratio": float(np.exp(np.median(apart))),
        "median_difference": float(np.median(np.abs(np.expm1(apart)))),
        "log_rms": float(np.sqrt(np.mean(apart**2))),
        "log_sd_for_80": float(np.quantile(np.abs(apart), 0.8) / _NORMAL_TAIL),
        "prediction_error": float(np.median(np.abs(np.expm1(away)))),
        "held": float(inside.mean()),
    }


def main() -> int:
    """Drive, and print a line per setup and per kind of terrain."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", default="warthog", help="name of an included calibration, or a file")
    parser.add_argument("--each", type=int, default=4, help="terrains of each of the kinds (4)")
    parser.add_argument("--starts", type=int, default=8, help="drives per terrain (8)")
    parser.add_argument("--setups", nargs="+", default=["usual"], choices=SETUPS)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    named = Path(given.vehicle)
    calibration = Calibration.load(named) if named.exists() else Calibration.shipped(given.vehicle)
    predictions = predict(calibration)
    for name in given.setups:
        begin = time.process_time()
        records = _recorded(given.out, name)
        done = {(record["kind"], record["index"]) for record in records}
        for record in compare(calibration, given.each, given.starts, SETUPS[name], done):
            records.append(record)
            if given.out:
                with given.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"setup": name, **record}) + "\n")
        _show(name, records, predictions)
        for kind in KINDS:
            _show(f"  {kind}", [record for record in records if record["kind"] == kind], predictions)
        sys.stdout.write(f"{time.process_time() - begin:.0f} s\n")
    return 0


def _recorded(path: Path | None, setup: str) -> list[dict[str, Any]]:
    """Return what an earlier run wrote for a setup."""
    if path is None or not path.exists():
        return []
    records = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [record for record in records if record["setup"] == setup]


def _show(name: str, records: list[dict[str, Any]], predictions: Predictions) -> None:
    found = summary(records, predictions)
    sys.stdout.write(f"{name:16} " + "  ".join(f"{key} {value:.3g}" for key, value in found.items()) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
