"""Drive the terrain library in a second physics engine, MuJoCo, and compare its C_r with that of the calibration.

pip install mujoco
python tests/benchmarks/second_simulator.py [--vehicle warthog] [--each 4] [--starts 8] [--setups softer slippery]

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
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.simulate.drive import DriveSettings, Outcome, follow
from bumpymap.lab.simulate.library import read_library
from bumpymap.lab.simulate.model import Physics, Pose, standing_pose, wheel_inertia
from bumpymap.lab.simulate.patch import PatchDrives, _seed
from bumpymap.lab.simulate.ride_fit import relief_and_slope
from bumpymap.lab.simulate.terrain import DrivenGround, PatchGround, Strip
from bumpymap.lab.worlds import KINDS
from bumpymap.rating import MAX_FAILED_SHARE, Calibration, RideModel, Vehicle, roll_over

_NORMAL_TAIL = NormalDist().inv_cdf(0.9)
_GRAVITY = 9.80665
_LIBRARY_STREAM = 4
_CELL_M = 0.1
_MOTOR_NMS = 2000.0
"""Torque per error of a wheel's speed, N m s/rad."""
_BODY_SHARE = 0.3
_WITHOUT_NOISE = 1e3

Predictions = dict[tuple[str, int], tuple[float, float, float]]


@dataclass(frozen=True, slots=True)
class Setup:
    """What is uncertain about a vehicle that its profile does not tell."""

    shape: str = "ellipsoid"
    """Of the wheels: ``ellipsoid`` and ``cylinder`` are as wide as the profile says; ``sphere``."""
    tyre_s: float = 0.015
    """Time constant of a contact, s: how fast a tyre that is pressed in comes back."""
    friction: float = 0.9
    time_step: float = 0.0025
    spring: float = 1.0
    """Factor on stiffness and damping of the rockers."""


SETUPS = {
    "usual": Setup(),
    "sphere": Setup(shape="sphere"),
    "cylinder": Setup(shape="cylinder"),
    "hard": Setup(tyre_s=0.006),
    "soft": Setup(tyre_s=0.04),
    "slippery": Setup(friction=0.5),
    "stiff": Setup(spring=2.0),
    "yielding": Setup(spring=0.5),
}


@dataclass(frozen=True, slots=True)
class Field:
    """Ground on the nodes of a grid."""

    middle: tuple[float, float]
    """Easting and northing, m."""
    heights: NDArray[np.float64]
    """(rows, cols) m; south row first."""

    @property
    def low(self) -> float:
        """Lowest height, m."""
        return float(self.heights.min())

    @property
    def span(self) -> float:
        """Highest above lowest height, m; above 0."""
        return max(float(np.ptp(self.heights)), 1e-3)


def model_xml(profile: Vehicle, setup: Setup, field: Field) -> str:
    """Return the MuJoCo model of a vehicle on ground whose heights are filled in later."""
    rows, cols = field.heights.shape
    half = f"{(cols - 1) * _CELL_M / 2} {(rows - 1) * _CELL_M / 2}"
    place = f"{field.middle[0]} {field.middle[1]} {field.low}"
    chassis, rocker, wheel, belly = profile.chassis, profile.rocker, profile.wheel, profile.belly
    under = belly.clearance_m - wheel.radius_m - chassis.com_height_m
    tall = _BODY_SHARE * belly.length_m
    sides = "".join(
        _side_xml(profile, setup, name, left)
        for name, left in (("left", profile.track_m / 2), ("right", -profile.track_m / 2))
    )
    motors = "".join(
        f'<velocity name="{side}_{end}" joint="{side}_{end}" kv="{_MOTOR_NMS}"/>'
        for side in ("left", "right")
        for end in ("front", "rear")
    )
    stiffness, damping = (
        setup.spring * value for value in (rocker.stiffness_nm_per_rad, rocker.damping_nms_per_rad)
    )  # fmt: skip
    return f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{setup.time_step}" gravity="0 0 {-_GRAVITY}" integrator="implicitfast" cone="elliptic"
   impratio="10"/>
  <default>
    <geom friction="{setup.friction} 0.005 0.0001" solref="{setup.tyre_s} 1" condim="3" contype="1" conaffinity="0"/>
    <default class="rocker"><joint type="hinge" axis="0 1 0" stiffness="{stiffness}" damping="{damping}" limited="true"
     range="{-rocker.limit_rad} {rocker.limit_rad}" solreflimit="0.01 1"/></default>
  </default>
  <asset><hfield name="ground" nrow="{rows}" ncol="{cols}" size="{half} {field.span} 1"/></asset>
  <worldbody>
    <geom name="ground" type="hfield" hfield="ground" pos="{place}" contype="0" conaffinity="1"/>
    <body name="chassis">
      <freejoint/>
      <inertial pos="0 0 0" mass="{chassis.mass_kg}" diaginertia="{_row(chassis.inertia_kgm2)}"/>
      <geom type="box" size="{belly.length_m / 2} {belly.width_m / 2} {tall / 2}" pos="0 0 {under + tall / 2}"/>
      {sides}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>"""


def _side_xml(profile: Vehicle, setup: Setup, name: str, left: float) -> str:
    """Return a rocker with its two wheels."""
    rocker, wheel = profile.rocker, profile.wheel
    radius, width = wheel.radius_m, wheel.width_m
    geom = {
        "ellipsoid": f'type="ellipsoid" size="{radius} {width / 2} {radius}"',
        "cylinder": f'type="cylinder" size="{radius} {width / 2}" euler="1.5707963267948966 0 0"',
        "sphere": f'type="sphere" size="{radius}"',
    }[setup.shape]
    wheels = "".join(
        f'<body pos="{ahead} 0 0"><joint name="{name}_{end}" type="hinge" axis="0 1 0"/>'
        f'<inertial pos="0 0 0" mass="{wheel.mass_kg}" diaginertia="{_row(wheel_inertia(profile))}"/>'
        f"<geom {geom}/></body>"
        for end, ahead in (("front", profile.wheelbase_m / 2), ("rear", -profile.wheelbase_m / 2))
    )
    return (
        f'<body pos="0 {left} {-profile.chassis.com_height_m}"><joint class="rocker"/>'
        f'<inertial pos="0 0 0" mass="{rocker.mass_kg}" diaginertia="{_row(rocker.inertia_kgm2)}"/>{wheels}</body>'
    )


def _row(values: tuple[float, float, float]) -> str:
    return " ".join(str(value) for value in values)


class MujocoVehicle:
    """A vehicle at the start of a strip of ground; see `bumpymap.lab.simulate.model.VehicleModel`."""

    def __init__(self, profile: Vehicle, ground: DrivenGround, strip: Strip, setup: Setup) -> None:
        import mujoco

        self._engine = mujoco
        self._radius = profile.wheel.radius_m
        field = _field(ground, strip)
        self._model = mujoco.MjModel.from_xml_string(model_xml(profile, setup, field))
        self._model.hfield_data[:] = ((field.heights - field.low) / field.span).ravel()
        self._data = mujoco.MjData(self._model)
        rotation, place = standing_pose(profile, ground, strip)
        self._data.qpos[:3] = place
        mujoco.mju_mat2Quat(self._data.qpos[3:7], np.ascontiguousarray(rotation).ravel())

    def command(self, left_mps: float, right_mps: float) -> None:
        """Set the speed of the tyres on either side."""
        self._data.ctrl[:] = np.repeat((left_mps, right_mps), 2) / self._radius

    def advance(self, steps: int) -> None:
        """Simulate ``steps`` time steps."""
        self._engine.mj_step(self._model, self._data, steps)

    def pose(self) -> Pose:
        """Return the present state of the chassis."""
        matrix = np.empty(9)
        self._engine.mju_quat2Mat(matrix, self._data.qpos[3:7])
        return Pose(
            easting=float(self._data.qpos[0]),
            northing=float(self._data.qpos[1]),
            heading=math.atan2(matrix[3], matrix[0]),
            tilt=math.acos(min(max(matrix[8], -1.0), 1.0)),
            pitch_rate=float(self._data.qvel[4]),
        )


def _field(ground: DrivenGround, strip: Strip) -> Field:
    """Return the ground of a rectangle that holds the strip."""
    along = np.array([math.cos(strip.heading), math.sin(strip.heading)])
    first = np.array([strip.easting, strip.northing])
    ends = np.stack([first, first + strip.length * along])
    low = np.floor((ends.min(axis=0) - strip.half_width) / _CELL_M).astype(int)
    high = np.ceil((ends.max(axis=0) + strip.half_width) / _CELL_M).astype(int)
    east, north = (np.arange(a, b + 1) * _CELL_M for a, b in zip(low, high, strict=True))
    easting, northing = np.meshgrid(east, north)
    middle = (low + high) * _CELL_M / 2
    return Field((float(middle[0]), float(middle[1])), ground.height(easting, northing))


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
        seeds = [_seed(calibration.settings["seed"], (*stream, k)) for k in range(starts)]
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
