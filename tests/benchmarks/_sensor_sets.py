"""Named sets of sensors for `drive_check.py`; what differs from vehicle to vehicle is drawn for each drive."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "worlds"))

from sensed_drives import GNSS, IMUS, ClockFault, DriveSensors

Draw = Callable[[np.random.Generator], DriveSensors]


def sensors(imu: str, gnss: str, mount_deg: float, *, vibration: bool = True, clock: bool = True) -> Draw:
    """Return how a set is drawn: mounted off by up to ``mount_deg`` about each axis, clock off by up to 1 s, 50 ppm."""

    def draw(rng: np.random.Generator) -> DriveSensors:
        mount = tuple((mount_deg * rng.uniform(-1, 1, 3)).tolist())
        off = ClockFault(float(rng.uniform(-1, 1)), float(rng.uniform(-50, 50)))
        made = DriveSensors(
            IMUS[imu],
            GNSS[gnss],
            mount_deg=(mount[0], mount[1], mount[2]),
            imu_arm_m=(0.2, 0.1, 0.3),
            antenna_arm_m=(-0.2, 0.05, 0.6),
            clock=off if clock else ClockFault(),
        )
        return made if vibration else replace(made, vibration=None)

    return draw


def perfect(_rng: np.random.Generator) -> DriveSensors:
    """Return sensors without any fault."""
    return DriveSensors(IMUS["perfect"], GNSS["perfect"], vibration=None)


SETS: Mapping[str, Draw] = {
    "perfect": perfect,
    "good": sensors("good", "rtk", 1.5),
    "cheap": sensors("cheap", "single", 5.0),
    # One thing other than in the good set each: what does it do?
    "good_5deg": sensors("good", "rtk", 5.0),
    "good_sbas": sensors("good", "sbas", 1.5),
    "good_1.5m": sensors("good", "single", 1.5),
    "good_still": sensors("good", "rtk", 1.5, vibration=False),
    "cheap_imu": sensors("cheap", "rtk", 1.5),
    "no_filter": sensors("cheap_unfiltered", "rtk", 1.5),
    "worst": sensors("cheap_unfiltered", "worst", 5.0),
}
