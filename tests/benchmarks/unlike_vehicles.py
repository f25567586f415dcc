"""Measure how far C_r moves when a vehicle is not what its profile says.

python tests/benchmarks/unlike_vehicles.py [--vehicle warthog] [--terrains 2] [--starts 4] [--kept FILE.json]

Each variant (stiffer, heavier, higher, on larger wheels) is driven over the same terrains of the library from the same
starts as the profile. Printed are the two numbers that `bumpymap check --refit` may move: the shift d0 of ln C_r in the
middle of the class limits, and the tilt d1 per ln C_r. Their scatter is the source of the prior in
bumpymap/rating/drive_update.py. With --kept, what is driven is kept and not driven again.
"""

import argparse
import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate.drive import DriveSettings, Effort, drive_patch
from bumpymap.lab.simulate.model import Physics
from bumpymap.lab.simulate.plan import library_terrain
from bumpymap.lab.worlds.terrains import KINDS
from bumpymap.rating import Calibration, Vehicle

STREAM = 77
LEAST_C_R = 0.005
Change = Callable[[Vehicle], Vehicle]


def part(table: str, key: str, factor: float, plus: float = 0.0) -> Change:
    """Return a change of one key of a table."""

    def change(profile: Vehicle) -> Vehicle:
        old = getattr(profile, table)
        return replace(profile, **{table: replace(old, **{key: getattr(old, key) * factor + plus})})

    return change


def whole(key: str, factor: float) -> Change:
    """Return a change of a key outside of the tables."""
    return lambda profile: replace(profile, **{key: getattr(profile, key) * factor})


def heavier(factor: float) -> Change:
    """Return a change of the mass of the chassis, its moments with it."""

    def change(profile: Vehicle) -> Vehicle:
        old = profile.chassis
        moments = tuple(each * factor for each in old.inertia_kgm2)
        return replace(profile, chassis=replace(old, mass_kg=old.mass_kg * factor, inertia_kgm2=moments))

    return change


VARIANTS: dict[str, Change] = {
    "springs x 2": part("rocker", "stiffness_nm_per_rad", 2),
    "springs x 4": part("rocker", "stiffness_nm_per_rad", 4),
    "springs x 0.5": part("rocker", "stiffness_nm_per_rad", 0.5),
    "damping x 4": part("rocker", "damping_nms_per_rad", 4),
    "damping x 0.25": part("rocker", "damping_nms_per_rad", 0.25),
    "rigid rockers": part("rocker", "limit_rad", 0.02),
    "chassis x 1.5": heavier(1.5),
    "chassis x 0.7": heavier(0.7),
    "higher by 0.2 m": part("chassis", "com_height_m", 1, 0.2),
    "wheels x 1.1": part("wheel", "radius_m", 1.1),
    "wheels x 0.9": part("wheel", "radius_m", 0.9),
    "wheelbase x 1.1": whole("wheelbase_m", 1.1),
    "wheelbase x 0.9": whole("wheelbase_m", 0.9),
    "speed x 1.2": whole("speed_mps", 1.2),
    "speed x 0.8": whole("speed_mps", 0.8),
    "friction 0.6": lambda profile: profile,
}


def drive_all(profile: Vehicle, base: Vehicle, terrains: int, starts: int, friction: float) -> list[float | None]:
    """Return the mean C_r over each terrain; the starts are those of every other variant."""
    settings = CalibrationSettings(base)
    driving = DriveSettings(physics=Physics(friction=friction))
    found: list[float | None] = []
    for kind in KINDS:
        for index in range(terrains):
            heights = library_terrain(settings, kind, index).heights
            stream = (STREAM, KINDS.index(kind), index)
            drives = drive_patch(profile, heights, settings.tile_size, 1, Effort.fixed(starts), driving, stream=stream)
            found.append(drives.mean_c_r if not drives.failed else None)
    return found


def moved(before: NDArray[np.float64], after: NDArray[np.float64], middle: float) -> dict[str, float]:
    """Return shift, tilt and what is left of ln C_r."""
    known = (before > LEAST_C_R) & (after > LEAST_C_R)
    x, y = np.log(before[known]) - middle, np.log(after[known] / before[known])
    design = np.column_stack((np.ones(len(x)), x))
    (d0, d1), *_ = np.linalg.lstsq(design, y, rcond=None)
    left = y - design @ (d0, d1)
    return {"n": int(known.sum()), "d0": d0, "d1": d1, "left": float(left.std(ddof=2)), "median": float(np.median(y))}


def main() -> None:
    """Drive all variants and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", default="warthog")
    parser.add_argument("--terrains", type=int, default=2)
    parser.add_argument("--starts", type=int, default=4)
    parser.add_argument("--kept", type=Path)
    asked = parser.parse_args()
    base = Vehicle.load(asked.vehicle)
    middle = math.log(Calibration.shipped(asked.vehicle).class_limits[1])
    kept: dict[str, Any] = json.loads(asked.kept.read_text()) if asked.kept and asked.kept.exists() else {}
    for name in ("as it is", *VARIANTS):
        key = json.dumps([asdict(base), name, asked.terrains, asked.starts])
        if key not in kept:
            began = time.monotonic()
            profile = VARIANTS[name](base) if name in VARIANTS else base
            friction = 0.6 if name == "friction 0.6" else Physics().friction
            kept[key] = drive_all(profile, base, asked.terrains, asked.starts, friction)
            print(f"drove {name} in {time.monotonic() - began:.0f} s", flush=True)
            if asked.kept:
                asked.kept.write_text(json.dumps(kept))
        c_r = np.array([np.nan if value is None else value for value in kept[key]])
        if name == "as it is":
            reference = c_r
            continue
        row = moved(reference, c_r, middle)
        print(f"{name:16} " + "  ".join(f"{label} {value:6.3f}" for label, value in row.items()), flush=True)


if __name__ == "__main__":
    main()
