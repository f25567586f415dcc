"""The signals of ULog files, which PX4 writes: microseconds since the start, x forward, y right, z down."""

import io
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import BadInputError, PlaceTrack, UsageError
from bumpymap.readers.drives.clock import in_order, sorted_times
from bumpymap.readers.drives.columns import check_lonlat
from bumpymap.readers.drives.signals import DriveSignals, Floats, Signal
from bumpymap.readers.source import decoding, open_source, size_of

__all__ = ["is_ulog", "ulog_signals"]

_MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35"
_MOST_BYTES = 2 << 30
_RATES = ("sensor_combined", "vehicle_angular_velocity")
_ACCELERATIONS = ("sensor_combined", "vehicle_acceleration")
_FIXES = ("vehicle_gps_position", "sensor_gps")
_ATTITUDE, _LOCAL = "vehicle_attitude", "vehicle_local_position"
_TOPICS = (*_RATES, "vehicle_acceleration", _ATTITUDE, *_FIXES, _LOCAL)
_TO_FLU = np.array([1.0, -1.0, -1.0])
"""x forward, y right, z down to x forward, y left, z up."""
_LEAST_FIX = 2
_ROUNDING = 0.1
"""Tolerance of the lengths of quaternions."""


def is_ulog(path: Path) -> bool:
    """Return whether a file is a ULog, by its suffix."""
    return path.suffix.lower() in {".ulg", ".ulog"}


def ulog_signals(path: Path) -> list[DriveSignals]:
    """Read the topics of a ULog that a drive needs.

    Raises
    ------
    BadInputError
        The file is damaged or too large, or is no ULog.
    UsageError
        The extra ``drives`` is not installed.
    """
    topics, listing, notes = _topics(path)
    imu = next((name for name in _RATES if name in topics), None)
    force = next((name for name in _ACCELERATIONS if name in topics), None)
    fixes = next((name for name in _FIXES if name in topics), None)
    found = []
    if imu is not None:
        rate = _vectors(topics[imu], ("gyro_rad", "xyz"), imu, notes)
        found.append(DriveSignals(imu, rate=rate, columns={"imu": imu}))
    if force is not None:
        acceleration = _vectors(topics[force], ("accelerometer_m_s2", "xyz"), force, notes)
        found.append(DriveSignals(force, acceleration=acceleration, columns={"imu": imu or force}))
    if _ATTITUDE in topics:
        found.append(_attitude(topics[_ATTITUDE], notes))
    if fixes is not None:
        found.append(DriveSignals(fixes, places=_fixes(topics[fixes], fixes, notes), columns={"gnss": fixes}))
    if _LOCAL in topics:
        found.append(DriveSignals(_LOCAL, places=_local(topics[_LOCAL], notes), columns={"odometry": _LOCAL}))
    if imu is not None or _ATTITUDE in topics:
        notes.append("axes of PX4 (x forward, y right, z down) are turned into x forward, y left, z up")
    return [*found, DriveSignals(path.name, notes=tuple(notes), listing=listing)]


def _topics(path: Path) -> tuple[dict[str, Mapping[str, Floats]], str, list[str]]:
    """Return the fields of the first instance of each topic that is read, what the file holds, and notes."""
    try:
        from pyulog import ULog
    except ImportError as error:
        raise UsageError(
            f"ULog files are read with pyulog, which cannot be imported ({error}): pip install 'bumpymap[drives]'"
        ) from error
    size = size_of(path)
    if size > _MOST_BYTES:
        raise BadInputError(
            f"{path} has {size / 1e9:,.1f} GB; at most {_MOST_BYTES / 1e9:,.1f} GB are read at once. Cut it into "
            "several drives"
        )
    with open_source(path) as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise BadInputError(f"{path} is no ULog: it does not begin with its signature. Copy or download it again")
        stream.seek(0)
        with decoding(path, "the ULog"), redirect_stdout(io.StringIO()):  # it prints what is damaged
            log: Any = ULog(stream, message_name_filter_list=list(_TOPICS))
    notes = [f"{path.name} is damaged in places, which are left out"] if log.file_corruption else []
    if log.dropouts:
        lost = sum(each.duration for each in log.dropouts) * 1e-3
        notes.append(f"the recorder of {path.name} dropped out {len(log.dropouts):,} times, for {lost:.1f} s in all")
    topics: dict[str, Mapping[str, Floats]] = {}
    for each in sorted(log.data_list, key=lambda data: data.multi_id):
        if len(each.data.get("timestamp", ())):
            topics.setdefault(each.name, each.data)
    listing = f"{path.name}: {', '.join(sorted({str(each.name) for each in log.data_list})) or 'no topic of a drive'}"
    return topics, listing, notes


def _samples(data: Mapping[str, Floats], fields: Sequence[str], topic: str, notes: list[str]) -> tuple[Floats, Floats]:
    """Return times (n,), s, and fields (n, k) as they are; NaN for those that the topic does not have."""
    time = np.asarray(data["timestamp"], np.float64) * 1e-6
    missing = np.full(len(time), np.nan)
    with np.errstate(invalid="ignore"):  # a NaN of float32 may be one that signals
        values = np.stack([np.asarray(data.get(field, missing), np.float64) for field in fields], axis=1)
    order = sorted_times(time, topic, notes)
    time, values = time[order], values[order]
    keep, note = in_order(time, topic)
    notes.extend([note] if note else [])
    return time[keep], values[keep]


def _vectors(data: Mapping[str, Floats], names: Sequence[str], topic: str, notes: list[str]) -> Signal | None:
    name = next((name for name in names if f"{name}[0]" in data), None)
    if name is None:
        return None
    time, values = _samples(data, [f"{name}[{axis}]" for axis in range(3)], topic, notes)
    good = np.isfinite(values).all(axis=1)
    return Signal(time[good], values[good] * _TO_FLU) if good.any() else None


def _attitude(data: Mapping[str, Floats], notes: list[str]) -> DriveSignals:
    time, turn = _samples(data, [f"q[{place}]" for place in (1, 2, 3, 0)], _ATTITUDE, notes)
    with np.errstate(invalid="ignore", over="ignore"):
        good = np.abs(np.linalg.norm(turn, axis=1) - 1.0) < _ROUNDING
    # Turned on both sides: the axes of the vehicle, and north, east, down into north, west, up.
    signal = Signal(time[good], turn[good] * np.append(_TO_FLU, 1.0)) if good.sum() > 1 else None
    return DriveSignals(_ATTITUDE, attitude=signal, columns={"attitude": _ATTITUDE})


def _fixes(data: Mapping[str, Floats], topic: str, notes: list[str]) -> PlaceTrack | None:
    new = "latitude_deg" in data
    fields = ("longitude_deg", "latitude_deg") if new else ("lon", "lat")
    time, values = _samples(data, (*fields, "fix_type", "eph"), topic, notes)
    lon, lat, fix, error = values.T
    lon, lat = (lon, lat) if new else (lon * 1e-7, lat * 1e-7)
    good = ~(fix < _LEAST_FIX) & np.isfinite(lon) & np.isfinite(lat)
    if lost := int((~good).sum()):
        notes.append(f"{lost:,} of {len(good):,} positions of {topic} were taken without a fix and are left out")
    if not good.any():
        return None
    lon, lat, _ = check_lonlat(lon[good], lat[good], topic, fields)
    return PlaceTrack(time[good], lon, lat, np.where(error[good] > 0.0, error[good], np.nan), "lonlat")


def _local(data: Mapping[str, Floats], notes: list[str]) -> PlaceTrack | None:
    """Return the estimated way; x is north and y east in the file."""
    time, values = _samples(data, ("y", "x"), _LOCAL, notes)
    valid = np.asarray(data["xy_valid"], bool) if "xy_valid" in data else np.ones(len(time), bool)
    good = np.isfinite(values).all(axis=1) & (valid if len(valid) == len(time) else True)
    if not good.any():
        return None
    return PlaceTrack(time[good], values[good, 0], values[good, 1], np.full(int(good.sum()), np.nan), "local")
