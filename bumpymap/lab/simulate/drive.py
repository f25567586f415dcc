"""Simulate drives: settle, accelerate, drive straight ahead at the profile's speed and record the pitch rate.

C_r is the integral of abs(omega_y) dt over the drive, divided by the horizontal length of the path (rad/m): the ride
cost of the BumpyPatch paper, here with omega_y in the body frame.

The terrain library of a calibration is ground of many kinds with a wide range of heights and slopes. A calibration
stores the drives, not the ground, which follows from the seed. A ride model can therefore be fitted again from the
file, without driving and with the same bits.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.lab.settings import CalibrationSettings, DriveSettings
from bumpymap.lab.simulate.jobs import Key
from bumpymap.lab.simulate.model import DartVehicle, DrivenGround, PatchGround, Pose, Strip, VehicleModel
from bumpymap.lab.terrains import KINDS, Terrain, make_terrain
from bumpymap.rating import Calibration, DrivenTerrain, Vehicle

Outcome = Literal["completed", "stuck", "rolled"]

_YAW_GAIN = 1.0
"""Yaw rate per heading error, 1/s."""
_SIDE_GAIN = 0.5
"""Tangent of the commanded heading correction per metre of lateral offset, 1/m."""
_MAX_STEERING = 0.5
"""Largest speed difference that steering may command, as a share of the speed."""
_LIBRARY_WHEEL_M = 0.3
"""The library's heights suit wheels of this radius; for other radii they are scaled."""


@dataclass(frozen=True, slots=True)
class Start:
    """Start position and heading of a drive."""

    easting: float
    """m."""
    northing: float
    """m."""
    heading: float
    """Radians from east to north."""


@dataclass(frozen=True, slots=True)
class Drive:
    """Result of one drive."""

    outcome: Outcome
    c_r: float
    """rad/m; NaN unless completed."""
    path_m: float
    """Horizontal length of the chassis' path during the measurement."""


def draw_start(ground: DrivenGround, rng: np.random.Generator) -> Start:
    """Draw a start within the extent of the ground, at any heading."""
    easting, northing, turn = rng.random(3).tolist()
    return Start(easting * ground.extent, northing * ground.extent, turn * 2 * math.pi)


def drive_from(profile: Vehicle, ground: DrivenGround, start: Start, settings: DriveSettings) -> Drive:
    """Drive over unbounded ground from a given start."""
    strip = drive_strip(profile, start, settings)
    return follow(DartVehicle(profile, ground, strip, settings.physics), strip, profile, settings)


def drive_strip(profile: Vehicle, start: Start, settings: DriveSettings) -> Strip:
    """Return the ground that a drive needs."""
    return Strip(
        easting=start.easting,
        northing=start.northing,
        heading=start.heading,
        length=profile.speed_mps * (settings.ramp_s / 2 + settings.cruise_s + settings.measure_s),
        half_width=profile.wheelbase_m / 2 + profile.track_m / 2 + profile.wheel.radius_m + settings.margin_m,
    )


def follow(vehicle: VehicleModel, strip: Strip, profile: Vehicle, settings: DriveSettings) -> Drive:
    """Drive a vehicle, placed at the start of a strip, along it and integrate its gyroscope readings."""
    period = 1 / settings.sample_hz
    quiet = settings.settle_s + settings.ramp_s + settings.cruise_s
    first, last = (round(seconds / period) for seconds in (quiet, quiet + settings.measure_s))
    pitched = path = progress = 0.0
    outcome: Outcome = "completed"
    pose = vehicle.pose()
    for sample in range(last):
        since = sample * period - settings.settle_s  # at rest before, then a ramp to full speed
        share = min(max(since / settings.ramp_s, 0.0), 1.0) if settings.ramp_s else float(since >= 0.0)
        _steer(vehicle, pose, strip, profile, profile.speed_mps * share)
        vehicle.advance(settings.steps_per_sample)
        before, pose = pose, vehicle.pose()
        if sample >= first:
            east, north = pose.easting - before.easting, pose.northing - before.northing
            path += math.hypot(east, north)
            progress += east * math.cos(strip.heading) + north * math.sin(strip.heading)
            pitched += (abs(before.pitch_rate) + abs(pose.pitch_rate)) / 2 * period
        if pose.tilt > math.radians(settings.rolled_deg):
            outcome = "rolled"
            break
        if abs(_lateral_offset(pose, strip)) > settings.margin_m:
            outcome = "stuck"
            break
    if outcome == "completed" and progress < settings.stuck_share * profile.speed_mps * settings.measure_s:
        outcome = "stuck"
    return Drive(outcome, pitched / path if outcome == "completed" else math.nan, path)


def _steer(vehicle: VehicleModel, pose: Pose, strip: Strip, profile: Vehicle, speed: float) -> None:
    """Steer towards the line by setting different speeds for the wheels of the two sides."""
    aim = strip.heading - math.atan(_SIDE_GAIN * _lateral_offset(pose, strip))
    heading_error = math.remainder(aim - pose.heading, 2 * math.pi)
    difference = _YAW_GAIN * heading_error * profile.track_m / 2
    most = _MAX_STEERING * speed
    difference = min(max(difference, -most), most)
    vehicle.command(speed - difference, speed + difference)


def _lateral_offset(pose: Pose, strip: Strip) -> float:
    """Return the distance of the vehicle to the left of its line, m."""
    east, north = pose.easting - strip.easting, pose.northing - strip.northing
    return north * math.cos(strip.heading) - east * math.sin(strip.heading)


@dataclass(frozen=True, slots=True)
class PatchDrives:
    """Results of the drives over one patch, in the order of the starts."""

    outcome: tuple[Outcome, ...]
    c_r: tuple[float | None, ...]
    """rad/m; None unless completed."""

    @classmethod
    def of(cls, drives: Sequence[Drive]) -> "PatchDrives":
        """Collect drives."""
        c_r = tuple(made.c_r if made.outcome == "completed" else None for made in drives)
        return cls(tuple(made.outcome for made in drives), c_r)

    @classmethod
    def read(cls, own: dict[str, Any]) -> "PatchDrives":
        """Read the fields of a journal."""
        return cls(tuple(own["outcome"]), tuple(own["c_r"]))

    @property
    def completed(self) -> list[float]:
        """C_r of the completed drives, rad/m."""
        return [value for value in self.c_r if value is not None]

    @property
    def mean_c_r(self) -> float | None:
        """Mean C_r of the completed drives, rad/m; None if there are none."""
        completed = self.completed
        return math.fsum(completed) / len(completed) if completed else None

    @property
    def standard_error(self) -> float | None:
        """Standard error of the mean, rad/m; None with fewer than two completed drives."""
        completed = self.completed
        if len(completed) < 2:
            return None
        return float(np.std(completed, ddof=1)) / math.sqrt(len(completed))

    @property
    def failed(self) -> int:
        """Number of drives that rolled over or got stuck."""
        return sum(outcome != "completed" for outcome in self.outcome)


def drive_patch(
    profile: Vehicle,
    heights: NDArray[np.floating],
    tile_size: float,
    seed: int,
    starts: int,
    settings: DriveSettings,
    *,
    stream: tuple[int, ...] = (),
) -> PatchDrives:
    """Drive over one patch (pixels, pixels) [m], north row first, without NaN, from random starts at random headings.

    Every start has its own random stream, so more drives never change earlier ones; ``stream`` distinguishes patches
    that share a seed. The result depends on the arguments only and is the same in any process.
    """
    ground = PatchGround.from_heights(heights, tile_size)
    streams = (np.random.SeedSequence(seed, spawn_key=(*stream, start)) for start in range(starts))
    draws = (np.random.default_rng(int(own.generate_state(1, np.uint64)[0])) for own in streams)
    return PatchDrives.of([drive_from(profile, ground, draw_start(ground, rng), settings) for rng in draws])


def calibrated_settings(calibration: Calibration) -> CalibrationSettings:
    """Return the settings of the vehicle, the seed and the tiles that a calibration was made with."""
    return CalibrationSettings(
        calibration.profile,
        seed=int(calibration.settings.get("seed", 1)),
        tile_size=calibration.tile_size,
        pixels=calibration.pixels,
    )


def library_terrain(settings: CalibrationSettings, kind: str, index: int) -> Terrain:
    """Make a terrain of the library for the vehicle: the height that a wheel climbs is proportional to its radius."""
    return make_terrain(
        kind,
        settings.seed,
        index,
        height_scale=settings.profile.wheel.radius_m / _LIBRARY_WHEEL_M,
        slope_limit_deg=settings.profile.slope_limit_deg,
        tile_size=settings.tile_size,
        pixels=settings.pixels,
    )


_COLUMNS = tuple(f.name for f in fields(DrivenTerrain) if f.name not in ("kind", "index"))


def driven_library(settings: CalibrationSettings, results: Mapping[Key, PatchDrives]) -> tuple[DrivenTerrain, ...]:
    """Summarise the drives over the library, kind by kind; C_r is rounded to six digits, as in the file."""
    return tuple(
        DrivenTerrain(
            kind=kind,
            index=index,
            c_r=six_digits(drives.mean_c_r),
            c_r_error=six_digits(drives.standard_error),
            completed=len(drives.completed),
            stuck=drives.outcome.count("stuck"),
            rolled=drives.outcome.count("rolled"),
        )
        for kind in KINDS
        for index in range(settings.terrains)
        for drives in (results["library", kind, index],)
    )


def library_record(driven: Sequence[DrivenTerrain]) -> dict[str, dict[str, list[Any]]]:
    """Return the entry of a calibration file: kind -> column -> one value per terrain, ordered by index."""
    record: dict[str, dict[str, list[Any]]] = {}
    for terrain in driven:
        for name in _COLUMNS:
            record.setdefault(terrain.kind, {}).setdefault(name, []).append(getattr(terrain, name))
    return record


def library_terrains(calibration: Calibration) -> tuple[DrivenTerrain, ...]:
    """Read the driven terrains from a calibration; raise BadInputError if the record is damaged."""
    try:
        return tuple(
            DrivenTerrain(kind, index, **dict(zip(_COLUMNS, values, strict=True)))
            for kind, columns in calibration.settings["library"].items()
            for index, values in enumerate(zip(*(columns[name] for name in _COLUMNS), strict=True))
        )
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise BadInputError(
            f"the record of the terrain library in the calibration {calibration.id} is damaged: {error!r}. "
            "Make it again with: bumpymap calibrate --vehicle FILE --out CALIBRATION.json"
        ) from error


def six_digits(value: float | None) -> float | None:
    """Round a figure as it is recorded; None for None and NaN."""
    return None if value is None or math.isnan(value) else float(f"{value:.6g}")
