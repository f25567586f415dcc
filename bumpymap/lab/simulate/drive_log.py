"""Record drives along ways in DART: the whole motion of the chassis at every time step, as the truth of a drive log.

A recorded drive begins and ends with a standstill and may stop on its way, as drives with real vehicles do. Steering,
speeds and outcome are those of `bumpymap.lab.simulate.way`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.simulate.drive import DriveSettings
from bumpymap.lab.simulate.guide import GuideLine
from bumpymap.lab.simulate.model import DartVehicle, Pose
from bumpymap.lab.simulate.relief import ReliefGround
from bumpymap.lab.simulate.way import Stop, WayDrive, follow_guide, vehicle_on_way
from bumpymap.lab.worlds import TrueDrive
from bumpymap.rating import Vehicle

__all__ = ["RecordSettings", "RecordedWay", "record_way"]

_TILE_M = 3.0
"""Side of the tiles of ``WayDrive.tiles``."""


@dataclass(frozen=True, slots=True)
class RecordSettings:
    """How a recorded drive begins, pauses and ends."""

    drive: DriveSettings = field(default_factory=DriveSettings)
    stand_before_s: float = 10.0
    """Standstill before the way, after the vehicle has settled."""
    stand_after_s: float = 5.0
    stops: Sequence[Stop] = ()
    """In the order of their distances."""


@dataclass(frozen=True, slots=True)
class RecordedWay:
    """A recorded drive."""

    result: WayDrive
    motion: TrueDrive
    """Places are in the coordinates of the ground."""


class MotionRecorder:
    """A vehicle in DART whose motion is recorded at every time step."""

    def __init__(self, vehicle: DartVehicle, unrecorded_steps: int) -> None:
        self._vehicle = vehicle
        self._unrecorded = unrecorded_steps
        self._rows: list[NDArray[np.float64]] = []

    def command(self, left_mps: float, right_mps: float) -> None:
        """Set the speed of the tyres on either side."""
        self._vehicle.command(left_mps, right_mps)

    def advance(self, steps: int) -> None:
        """Simulate ``steps`` time steps and record the motion after each, but for the first ones of all."""
        for _ in range(steps):
            self._vehicle.advance(1)
            if self._unrecorded:
                self._unrecorded -= 1
            else:
                self._rows.append(self._vehicle.motion())

    def pose(self) -> Pose:
        """Return the present state of the chassis."""
        return self._vehicle.pose()

    def motion(self, time_step: float) -> TrueDrive:
        """Return what was recorded."""
        rows = np.array(self._rows).reshape(-1, 20)
        return TrueDrive(
            rate_hz=1 / time_step,
            place=rows[:, 9:12],
            rotation=rows[:, :9].reshape(-1, 3, 3),
            rates=rows[:, 12:15],
            velocity=rows[:, 15:18],
            wheels=rows[:, 18:],
        )


def record_way(
    profile: Vehicle, ground: ReliefGround, corners: NDArray[np.float64], settings: RecordSettings | None = None
) -> RecordedWay:
    """Drive along a line in DART and record the motion; the same arguments give the same bits in any process.

    Parameters
    ----------
    profile : Vehicle
    ground : ReliefGround
    corners : array (n, 2)
        The line, m east and north of the ground's south-west corner.
    settings : RecordSettings, optional
    """
    settings = settings or RecordSettings()
    drive, physics = settings.drive, settings.drive.physics
    guide = GuideLine.along(corners)
    recorder = MotionRecorder(vehicle_on_way(profile, ground, guide, drive), round(drive.settle_s / physics.time_step))
    standing = replace(drive, settle_s=drive.settle_s + settings.stand_before_s)
    result = follow_guide(recorder, guide, profile, _TILE_M, standing, settings.stops)
    brake = np.linspace(1.0, 0.0, max(round(drive.ramp_s * drive.sample_hz), 1))
    for share in np.append(brake, np.zeros(round(settings.stand_after_s * drive.sample_hz))):
        recorder.command(share * profile.speed_mps, share * profile.speed_mps)
        recorder.advance(drive.steps_per_sample)
    return RecordedWay(result, recorder.motion(physics.time_step))
