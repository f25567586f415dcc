"""The signals of bags of ROS 2 and ROS 1: which topics are read, and what their messages hold."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bumpymap.core import BadInputError, PlaceTrack, WheelTrack
from bumpymap.readers.drives.clock import in_order, sorted_times
from bumpymap.readers.drives.columns import check_lonlat, guess_local, refuse_odd_rates
from bumpymap.readers.drives.signals import DriveSignals, Floats, Signal, attitudes
from bumpymap.readers.frames.raw import BagReader

__all__ = ["bag_signals"]


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


class _Topic(NamedTuple):
    name: str
    kind: str
    """Type of its messages."""


def bag_signals(paths: Sequence[Path], columns: Mapping[str, str]) -> list[DriveSignals]:
    """Read the topics of bags that a drive needs. Several bags are one recording, or hold its topics between them.

    Parameters
    ----------
    paths : sequence of Path
        Files or folders.
    columns : mapping
        ``imu``, ``gnss``, ``odometry`` and ``twist`` -> topic; an empty name: none.

    Raises
    ------
    BadInputError
        A bag is damaged, a topic is not there, or several may be meant.
    UsageError
        The extra ``ros`` is not installed.
    """
    name = ", ".join(path.name for path in paths)
    bags = [BagReader(path) for path in paths]
    held: dict[str, tuple[str, int]] = {}
    for bag in bags:
        for topic, (kind, count) in bag.topics.items():
            held[topic] = (kind, count + held.get(topic, (kind, 0))[1])
    topics = {role: topic for role in _TYPES if (topic := _choose(name, held, role, columns.get(role)))}
    found = [_signals(role, topics[role].name, rows) for role, rows in _messages(bags, topics).items() if len(rows)]
    listing = f"{name}: {', '.join(f'{topic} ({kind})' for topic, (kind, _) in sorted(held.items())) or 'no topics'}"
    return [*found, DriveSignals(name, listing=listing)]


def _messages(bags: Sequence[BagReader], topics: Mapping[str, _Topic]) -> dict[str, Floats]:
    """Return what is read of the messages of each role, (n, k), times in s first."""
    rows: dict[str, array[float]] = {role: array("d") for role in topics}
    roles = {topic.name: role for role, topic in topics.items()}
    for bag in bags:
        for record in bag.messages(set(roles) & set(bag.topics)):
            role = roles[record.topic]
            message = bag.decode(record.data, topics[role].kind)
            stamp = message.header.stamp
            nanoseconds = stamp.sec * 1_000_000_000 + stamp.nanosec or record.time_ns
            rows[role].append(nanoseconds * 1e-9)
            rows[role].extend(_READ[role](message))
    return {role: np.frombuffer(values, np.float64).reshape(-1, _WIDTH[role]) for role, values in rows.items()}


def _choose(name: str, topics: Mapping[str, tuple[str, int]], role: str, wanted: str | None) -> _Topic | None:
    """Return the topic to read for a role: the wanted one, or the only one of the best type."""
    if wanted == "":
        return None
    of_type = {
        kind: sorted(name for name, (each, count) in topics.items() if each == kind and count) for kind in _TYPES[role]
    }
    if wanted is not None:
        kind = topics[wanted][0] if wanted in topics else ""
        if kind in of_type:
            return _Topic(wanted, kind)
        listed = ", ".join(name for names in of_type.values() for name in names) or "none"
        raise BadInputError(
            f"the bag {name} has no topic {wanted} of type {' or '.join(_TYPES[role])}. Topics of this type with "
            f"messages: {listed}"
        )
    kind, names = next(((kind, names) for kind, names in of_type.items() if names), ("", []))
    if len(names) > 1:
        raise BadInputError(
            f"the bag {name} has several topics of type {kind}: {', '.join(names)}. Name the one to read: "
            f"`columns='{role}={names[0]}'`; with `columns='{role}='` none is read"
        )
    return _Topic(names[0], kind) if names else None


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
    return (message.longitude, message.latitude, variance, message.status.status)


def _read_odometry(message: Any) -> tuple[float, ...]:
    pose = getattr(message.pose, "pose", message.pose)
    twist = getattr(message, "twist", None)
    place, turn = pose.position, pose.orientation
    speed = np.nan if twist is None else twist.twist.linear.x
    return (place.x, place.y, turn.x, turn.y, turn.z, turn.w, speed)


def _read_twist(message: Any) -> tuple[float, ...]:
    return (getattr(message.twist, "twist", message.twist).linear.x,)


_NONE = (np.nan,) * 4
_READ: Mapping[str, Callable[[Any], tuple[float, ...]]] = {
    "imu": _read_imu,
    "gnss": _read_fix,
    "odometry": _read_odometry,
    "twist": _read_twist,
}
_WIDTH = {"imu": 11, "gnss": 5, "odometry": 8, "twist": 2}
"""Numbers of a message, with its time."""


def _signals(role: str, topic: str, rows: Floats) -> DriveSignals:
    """Return the signals of the messages of a topic: (n, k), time first."""
    notes: list[str] = []
    rows = rows[sorted_times(rows[:, 0], topic, notes)]
    keep, note = in_order(rows[:, 0], topic)
    notes.extend([note] if note else [])
    rows = rows[keep]
    if role == "imu":
        rate = _part(rows, slice(1, 4))
        if rate is not None:
            refuse_odd_rates(rate.values, topic, ("x", "y", "z"), known=True)
        signals = DriveSignals(topic, rate, _part(rows, slice(4, 7)), _turns(rows, slice(7, 11)))
    elif role == "gnss":
        signals = DriveSignals(topic, places=_fixes(topic, rows, notes))
    else:
        moved = role == "odometry"
        speed = _part(rows, slice(7, 8) if moved else slice(1, 2))
        unknown = np.full(0 if speed is None else len(speed.time), np.nan)
        signals = DriveSignals(
            topic,
            attitude=_turns(rows, slice(3, 7)) if moved else None,
            places=_odometry_places(topic, rows, notes) if moved else None,
            wheels=None if speed is None else WheelTrack(speed.time, speed.values[:, 0], unknown),
        )
    return replace(signals, columns={role: topic}, notes=tuple(notes))


def _part(rows: Floats, columns: slice) -> Signal | None:
    good = np.isfinite(rows[:, columns]).all(axis=1)
    return Signal(rows[good, 0], rows[good, columns]) if good.any() else None


def _turns(rows: Floats, columns: slice) -> Signal | None:
    """Return quaternions; None if they are not set (all zero, or all the same)."""
    found = attitudes(rows[:, 0], rows[:, columns])
    return found if found is not None and np.ptp(found.values, axis=0).any() else None


def _fixes(topic: str, rows: Floats, notes: list[str]) -> PlaceTrack | None:
    time, lon, lat, variance, status = rows.T
    good = np.isfinite(lon) & np.isfinite(lat) & (status >= 0.0) & ~((lon == 0.0) & (lat == 0.0))
    if lost := int((~good).sum()):
        notes.append(f"{lost:,} of {len(good):,} positions of {topic} were taken without a fix and are left out")
    if not good.any():
        return None
    lon, lat, note = check_lonlat(lon[good], lat[good], topic, ("longitude", "latitude"))
    notes.extend([note] if note else [])
    with np.errstate(invalid="ignore"):
        error = np.where(variance[good] > 0.0, np.sqrt(variance[good]), np.nan)
    return PlaceTrack(time[good], lon, lat, error, "lonlat")


def _odometry_places(topic: str, rows: Floats, notes: list[str]) -> PlaceTrack | None:
    good = np.isfinite(rows[:, 1:3]).all(axis=1)
    if not good.any():
        return None
    time, x, y = rows[good, :3].T
    kind, note = guess_local(x, y, topic)
    notes.append(note)
    return PlaceTrack(time, x, y, np.full(len(time), np.nan), kind)
