"""Drives in closed form: pitch, roll and way are known, and what sensors would record; frames of a scanner as files."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bumpymap.core import DriveLog, ImuTrack, PlaceTrack

GRAVITY = 9.81


@dataclass(frozen=True)
class MadeDrive:
    """What was put in."""

    amplitude: float = 0.25
    """Of the pitch rate, rad/s; that of the roll rate is 1.5 times it."""
    speed: float = 1.0
    seconds: float = 120.0
    stand: float = 12.0
    hertz: float = 100.0
    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw of the sensor in the vehicle."""
    offset: float = 0.0
    """To add to the times of the positions for those of the IMU, s."""
    noise: float = 0.0
    """Of the angular rates, rad/s for each sample."""
    bias: float = 0.0
    place_white: float = 0.0
    place_wander: float = 0.0
    place_hertz: float = 10.0
    turning: float = 1.0
    stops: tuple[tuple[float, float], ...] = ()
    """Beginning and end of each stop on the way, s."""
    seed: int = 0


def motion(made: MadeDrive):
    """Return time, speed, yaw rate, pitch rate, roll rate of the vehicle."""
    rng = np.random.default_rng(made.seed)
    time = np.arange(0.0, made.seconds, 1.0 / made.hertz)
    ramp = np.clip((time - made.stand) / 1.5, 0, 1) * np.clip((made.seconds - made.stand / 2 - time) / 1.5, 0, 1)
    for begin, end in made.stops:
        ramp *= np.clip(np.maximum(begin - time, time - end) / 1.5, 0, 1)
    ramp = ramp * ramp * (3 - 2 * ramp)
    speed = made.speed * ramp
    yaw_rate = made.turning * 0.35 * np.maximum(np.sin(2 * np.pi * time / 37.0), 0.0) ** 3 * ramp
    yaw_rate -= made.turning * 0.35 * np.maximum(np.sin(2 * np.pi * time / 29.0 + 2), 0.0) ** 3 * ramp
    waves = rng.uniform(0.3, 3.0, (2, 12))
    phase = rng.uniform(0, 2 * np.pi, (2, 12))
    swing = np.sin(2 * np.pi * waves[:, :, None] * time + phase[:, :, None]).sum(axis=1) / np.sqrt(6)
    return time, speed, yaw_rate, made.amplitude * swing[0] * ramp, 1.5 * made.amplitude * swing[1] * ramp


def log_of(made: MadeDrive) -> tuple[DriveLog, np.ndarray, np.ndarray]:
    """Return the log of a drive, its true pitch rates and its true way at the samples of the IMU."""
    rng = np.random.default_rng(made.seed + 1)
    time, speed, yaw_rate, pitch_rate, roll_rate = motion(made)
    step = 1.0 / made.hertz
    heading = np.cumsum(yaw_rate) * step
    place = np.cumsum(speed * np.exp(1j * heading)) * step
    pitch, roll = np.cumsum(pitch_rate) * step, np.cumsum(roll_rate) * step
    angles = np.stack([heading, pitch - pitch.mean(), roll - roll.mean()], axis=1)
    body = Rotation.from_euler("ZYX", angles)
    turns = (body[:-1].inv() * body[1:]).as_rotvec() / step
    turns = 0.5 * (np.concatenate([turns[:1], turns]) + np.concatenate([turns, turns[-1:]]))
    body = Rotation.from_euler("ZYX", angles * [0, 1, 1])
    felt = np.stack([np.gradient(speed, step), speed * yaw_rate, np.full(len(time), GRAVITY)], axis=1)
    force = body.inv().apply(felt)
    mount = Rotation.from_euler("ZYX", made.mount_deg[::-1], degrees=True)
    rate = mount.inv().apply(turns)
    rate = rate + made.bias + made.noise * rng.normal(size=rate.shape)
    force = mount.inv().apply(force) + 0.02 * rng.normal(size=rate.shape)
    at = np.arange(0.5, made.seconds - 0.5, 1.0 / made.place_hertz)
    seen = np.interp(at, time, place.real) + 1j * np.interp(at, time, place.imag)
    keep = np.exp(-1 / made.place_hertz / 60.0)
    steps = rng.normal(size=(len(at), 2)) @ [1, 1j] * made.place_wander
    wander = np.zeros(len(at), complex)
    for k in range(len(at)):
        wander[k] = steps[k] if k == 0 else keep * wander[k - 1] + np.sqrt(1 - keep**2) * steps[k]
    seen = seen + wander + made.place_white * (rng.normal(size=(len(at), 2)) @ [1, 1j])
    places = PlaceTrack(at - made.offset, seen.real, seen.imag, np.full(len(at), np.nan), "projected")
    imu = ImuTrack(time, rate, force)
    return DriveLog("made", (Path("made.csv"),), imu, places, None), turns[:, 1], np.cumsum(speed) * step


def write_table(path: Path, log: DriveLog, corner: tuple[float, float]) -> Path:
    """Write a log as one CSV file, its way from a corner (easting, northing) [m] on; rows repeat the last place."""
    imu, places = log.imu, log.places
    last = np.maximum(np.searchsorted(places.time, imu.time + 1e-6) - 1, 0)
    at = [(places.x, places.y)[axis][last] + corner[axis] for axis in (0, 1)]
    head = "time [s],gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s],acc_x [m/s2],acc_y [m/s2],acc_z [m/s2]"
    table = np.column_stack([imu.time, imu.rate, imu.acceleration, *at])
    np.savetxt(path, table, delimiter=",", header=f"{head},easting [m],northing [m]", comments="")
    return path


def write_drive(path: Path) -> Path:
    """Write the log of a drive of 24 m straight over the sample survey."""
    log, _, _ = log_of(MadeDrive(seconds=42.0, turning=0.0))
    return write_table(path, log, (512350.0, 5403260.0))


POINTS, LABELS = "os1_cloud_node_kitti_bin", "os1_cloud_node_semantickitti_label_id"
"""Folders of a sequence of RELLIS-3D."""


def write_bin(path, points):
    """Write points (n, 3) m, of one intensity, as KITTI lays them out."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.column_stack([points, np.full(len(points), 0.5)]).astype("<f4").tofile(path)
    return path


def churned_field(seed, count=60_000):
    """Points of a field around a sensor, smooth on the right and churned on the left, (n, 3) m."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-18, 18, (count, 2))
    churned = np.where(place[:, 1] > 0, 0.3 * rng.uniform(-1, 1, count), 0)
    return np.column_stack([place, -1.5 + rng.normal(0, 0.01, count) + churned])


def ring_of_ground(rough, level=-1.5, count=8000):
    """Points of ground between 5 and 11 m around a sensor, as rough as it is told [m], (n, 3) m."""
    rng = np.random.default_rng(1)
    away, turn = rng.uniform(5, 11, count), rng.uniform(0, 2 * np.pi, count)
    return np.column_stack([away * np.cos(turn), away * np.sin(turn), rng.normal(level, rough, count)])


def write_rellis(root):
    """Two sequences in the layout of RELLIS-3D, each frame of grass, bushes or trees alone; returns their folder."""
    for sequence, count in (("00000", 6), ("00003", 2)):
        for number in range(count):
            label, rough = ((3, 0.01), (19, 0.1), (4, 0.4))[number % 3]
            points = write_bin(root / sequence / POINTS / f"{number:06d}.bin", ring_of_ground(rough))
            labels = root / sequence / LABELS / f"{points.stem}.label"
            labels.parent.mkdir(exist_ok=True)
            np.full(8000, label, "<u4").tofile(labels)
    return root
