"""A vehicle in MuJoCo, for `second_simulator`: wheels of their true width, tyres that give way, ground as a field."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.simulate.model import Pose, standing_pose, wheel_inertia
from bumpymap.lab.simulate.terrain import DrivenGround, Strip
from bumpymap.rating import Vehicle

_GRAVITY = 9.80665
_CELL_M = 0.1
_MOTOR_NMS = 2000.0
"""Torque per error of a wheel's speed, N m s/rad."""
_BODY_SHARE = 0.3


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
        field = field_under(ground, strip)
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


def field_under(ground: DrivenGround, strip: Strip) -> Field:
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
