"""Samples of recordings with topics: bags of ROS 2 and ROS 1, and ULog files (PX4: times in microseconds, z down)."""

import io
from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import BadInputError, UsageError, install_command
from bumpymap.readers.drives.quantities import ACCELERATIONS, DOWN, LOCAL, LONLAT, QUATERNION, RATES
from bumpymap.readers.drives.signals import Floats, Samples
from bumpymap.readers.drives.tables import refuse_large
from bumpymap.readers.frames.raw import BagReader, choose_topic, held_topics
from bumpymap.readers.source import decoding, open_source


def _sorted(values: dict[str, Floats], topic: str, notes: list[str]) -> dict[str, Floats]:
    """Sort messages by their stamps; a recorder stores them as they arrive."""
    time = values["time"]
    if late := int((np.diff(time) < 0.0).sum()):
        notes.append(f"{late:,} messages of {topic} arrived after later ones and are sorted by their stamps")
    order = np.argsort(time, kind="stable")
    return {quantity: each[order] for quantity, each in values.items()}


def _read_imu(message: Any) -> tuple[float, ...]:
    rate, force, turn = message.angular_velocity, message.linear_acceleration, message.orientation
    # The first covariance is -1 where the sensor does not measure a quantity.
    has_rate = message.angular_velocity_covariance[0] != -1.0
    has_force = message.linear_acceleration_covariance[0] != -1.0
    has_turn = message.orientation_covariance[0] != -1.0
    return (
        *((rate.x, rate.y, rate.z) if has_rate else _NONE[:3]),
        *((force.x, force.y, force.z) if has_force else _NONE[:3]),
        *((turn.x, turn.y, turn.z, turn.w) if has_turn else _NONE),
    )


def _read_fix(message: Any) -> tuple[float, ...]:
    covariance = message.position_covariance
    known = message.position_covariance_type > 0
    variance = 0.5 * (covariance[0] + covariance[4]) if known else np.nan
    return (message.longitude, message.latitude, max(variance, 0.0) ** 0.5, message.status.status)


def _read_odometry(message: Any) -> tuple[float, ...]:
    pose = getattr(message.pose, "pose", message.pose)
    twist = getattr(message, "twist", None)
    place, turn = pose.position, pose.orientation
    speed = np.nan if twist is None else twist.twist.linear.x
    return (place.x, place.y, turn.x, turn.y, turn.z, turn.w, speed)


_NONE = (np.nan,) * 4
_TYPES: Mapping[str, tuple[str, ...]] = {
    "imu": ("sensor_msgs/msg/Imu",),
    "gnss": ("sensor_msgs/msg/NavSatFix",),
    "odometry": (
        "nav_msgs/msg/Odometry",
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
    ),
    "twist": ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/TwistWithCovarianceStamped"),
}
"""Purpose of a topic -> types of its messages, the best one first."""
_READ: Mapping[str, tuple[tuple[str, ...], Callable[[Any], tuple[float, ...]]]] = {
    "imu": ((*RATES, *ACCELERATIONS, *QUATERNION), _read_imu),
    "gnss": ((*LONLAT, "error", "fix"), _read_fix),
    "odometry": ((*LOCAL, *QUATERNION, "speed"), _read_odometry),
    "twist": (("speed",), lambda message: (getattr(message.twist, "twist", message.twist).linear.x,)),
}
"""Purpose of a topic -> quantities that are read of its messages, and how."""


def bag_samples(paths: Sequence[Path], columns: Mapping[str, str]) -> list[Samples]:
    """Read the topics of bags that a drive needs. Several bags are one recording, or hold its topics between them.

    ``paths``: files or folders; ``columns``: ``imu``, ``gnss``, ``odometry`` and ``twist`` ->
    topic; an empty name: none. Raises BadInputError: a bag is damaged, a topic is not there, or
    several may be meant; UsageError: the extra ``ros`` is not installed.
    """
    name = ", ".join(path.name for path in paths)
    bags = [BagReader(path) for path in paths]
    held = held_topics(bags)
    filled = {topic: own for topic, own in held.items() if own[1]}
    roles: dict[str, str] = {}
    for role in _TYPES:
        wanted = columns.get(role)
        hint = f"Name the one to read, `columns='{role}={{}}'`; with `columns='{role}='` none is read"
        chosen = None if wanted == "" else choose_topic(held if wanted else filled, _TYPES[role], wanted, hint)
        roles |= {chosen: role} if chosen else {}
    rows: dict[str, array[float]] = {topic: array("d") for topic in roles}
    for bag in bags:
        for record in bag.messages(set(roles) & set(bag.topics)):
            message = bag.decode(record.data, held[record.topic][0])
            stamp = message.header.stamp
            nanoseconds = stamp.sec * 1_000_000_000 + stamp.nanosec or record.time_ns
            rows[record.topic].append(nanoseconds * 1e-9)
            rows[record.topic].extend(_READ[roles[record.topic]][1](message))
    listing = f"{name}: {', '.join(f'{topic} ({kind})' for topic, (kind, _) in sorted(held.items())) or 'no topics'}"
    found = [Samples(name, listing=listing)]
    for topic, role in roles.items():
        quantities, notes = ("time", *_READ[role][0]), list[str]()
        if rows[topic]:
            table = np.frombuffer(rows[topic], np.float64).reshape(-1, len(quantities))
            values = _sorted(dict(zip(quantities, table.T, strict=True)), topic, notes)
            found.append(Samples(topic, values, {role: topic}, notes))
    return found


_MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35"


def _vector(quantities: tuple[str, ...], name: str) -> dict[str, tuple[str, float]]:
    return {quantity: (f"{name}[{axis}]", 1.0) for axis, quantity in enumerate(quantities)}


_FIX = {
    "longitude": ("longitude_deg", 1.0),
    "latitude": ("latitude_deg", 1.0),
    "error": ("eph", 1.0),
    "fix": ("fix_type", 1.0),
}
_OLD_FIX = _FIX | {"longitude": ("lon", 1e-7), "latitude": ("lat", 1e-7)}
_FIELDS: Mapping[str, tuple[str, Sequence[Mapping[str, tuple[str, float]]]]] = {
    "sensor_combined": ("imu", [_vector(RATES, "gyro_rad") | _vector(ACCELERATIONS, "accelerometer_m_s2")]),
    "vehicle_angular_velocity": ("imu", [_vector(RATES, "xyz")]),
    "vehicle_acceleration": ("imu", [_vector(ACCELERATIONS, "xyz")]),
    "vehicle_attitude": ("attitude", [_vector(("q_w", "q_x", "q_y", "q_z"), "q")]),
    "vehicle_gps_position": ("gnss", [_FIX, _OLD_FIX]),
    "sensor_gps": ("gnss", [_FIX, _OLD_FIX]),
    # x is north and y east in the file
    "vehicle_local_position": ("odometry", [{"x": ("y", 1.0), "y": ("x", 1.0), "fix": ("xy_valid", 1.0)}]),
}
"""Topic -> purpose, and the fields that are read with a factor to the unit of `DriveLog`, as each version has them."""
_ALTERNATIVES = (
    ("sensor_combined", "vehicle_angular_velocity"),
    ("sensor_combined", "vehicle_acceleration"),
    ("vehicle_attitude",),
    ("vehicle_gps_position", "sensor_gps"),
    ("vehicle_local_position",),
)
"""Topics of which the first one that is there is read."""
_LEAST_FIX = {"gnss": 2.0, "odometry": 1.0}


def is_ulog(path: Path) -> bool:
    """Return whether a file is a ULog, by its suffix."""
    return path.suffix.lower() in {".ulg", ".ulog"}


def ulog_samples(path: Path) -> list[Samples]:
    """Read the topics of a ULog that a drive needs, the first instance of each.

    Raises BadInputError: the file is damaged or too large, or is no ULog; UsageError: the extra
    ``drives`` is not installed.
    """
    try:
        from pyulog import ULog
    except ImportError as error:
        raise UsageError(
            f"ULog files are read with pyulog, which cannot be imported ({error}): {install_command('drives')}"
        ) from error
    refuse_large(path)
    with open_source(path) as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise BadInputError(f"{path} is no ULog: it does not begin with its signature. Copy or download it again")
        stream.seek(0)
        with decoding(path, "the ULog"), redirect_stdout(io.StringIO()):  # it prints what is damaged
            log: Any = ULog(stream, message_name_filter_list=list(_FIELDS))
    notes = [f"{path.name} is damaged in places, which are left out"] if log.file_corruption else []
    if log.dropouts:
        lost = sum(each.duration for each in log.dropouts) * 1e-3
        notes.append(f"the recorder of {path.name} dropped out {len(log.dropouts):,} times, for {lost:.1f} s in all")
    topics: dict[str, Mapping[str, Any]] = {}
    for each in sorted(log.data_list, key=lambda data: data.multi_id):
        if len(each.data.get("timestamp", ())):
            topics.setdefault(each.name, each.data)
    read = dict.fromkeys(next((name for name in names if name in topics), "") for names in _ALTERNATIVES)
    found = [_ulog_topic(name, topics[name], notes) for name in read if name]
    if any({*DOWN} & set(samples.values) for samples in found):
        notes.append("axes of PX4 (x forward, y right, z down) are turned into x forward, y left, z up")
    listing = f"{path.name}: {', '.join(sorted({str(each.name) for each in log.data_list})) or 'no topic of a drive'}"
    return [*found, Samples(path.name, notes=notes, listing=listing)]


def _ulog_topic(name: str, data: Mapping[str, Any], notes: list[str]) -> Samples:
    role, versions = _FIELDS[name]
    fields = next((each for each in versions if next(iter(each.values()))[0] in data), versions[-1])
    values = {"time": np.asarray(data["timestamp"], np.float64) * 1e-6}
    for quantity, (field, factor) in fields.items():
        if field in data:
            with np.errstate(invalid="ignore"):  # a NaN of float32 may be one that signals
                values[quantity] = np.asarray(data[field], np.float64) * (-factor if quantity in DOWN else factor)
    if "fix" in values:
        values["fix"] = values["fix"] - _LEAST_FIX[role]
    return Samples(name, _sorted(values, name, notes), {role: name}, notes=[])
