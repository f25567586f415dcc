"""Read a recorded drive from files of any format; the signals of ULog files (PX4: times in microseconds, z down)."""

import io
import os
import re
import threading
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from itertools import chain, takewhile
from pathlib import Path
from traceback import format_exc
from typing import Any

import numpy as np

from bumpymap.core import (
    BadInputError,
    BumpymapError,
    Child,
    DecoderError,
    DriveLog,
    Guard,
    PlaceTrack,
    UsageError,
    can_start_children,
    free_memory,
    missing_resource,
)
from bumpymap.readers.drives.bag_signals import bag_signals
from bumpymap.readers.drives.clock import in_order, sorted_times
from bumpymap.readers.drives.columns import TOPICS, check_lonlat, unknown_quantities
from bumpymap.readers.drives.signals import QUANTITIES, DriveSignals, Floats, Signal, assemble, attitudes
from bumpymap.readers.drives.table_signals import find_columns, refuse_binary, table_signals
from bumpymap.readers.drives.text_table import TextTable, open_table
from bumpymap.readers.frames.raw import bag_files, is_bag, is_ros1
from bumpymap.readers.source import decoding, open_source, size_of

__all__ = ["close_log_reader", "drive_files", "is_ulog", "read_drive", "read_in_child", "ulog_signals"]

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
    # Turned on both sides: the axes of the vehicle, and north, east, down into north, west, up.
    signal = attitudes(time, turn * np.append(_TO_FLU, 1.0))
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


SECONDS, SECONDS_PER_BYTE = 10.0, 2e-6
"""CPU time limit of reading a drive, and for each byte of its files: ten times what real ones need."""
_MEMORY, _MEMORY_PER_BYTE = 1 << 30, 30
"""Limit of the memory of the process that reads, likewise."""
_COPY_AGAIN = "The file is damaged; copy or download it again"
_lock = threading.Lock()
_guard = Guard(lambda: Child("to read logs", __name__), "reads logs of drives", "bumpymap")
"""Parsers of logs run or allocate without end on some damaged files."""


def read_drive(place: str, columns: Mapping[str, str] | None = None) -> DriveLog:
    """Read what the sensors of a vehicle recorded on a drive.

    Parameters
    ----------
    place : str
        A file, the folder of a bag, or several files of one drive joined by commas, in any order:
        ``imu.csv,gnss.csv``. CSV and other tables of text, bags of ROS 2 and ROS 1, ULog.
    columns : mapping, optional
        Quantity -> column, perhaps with its unit: ``{"rate_y": "GyrY[deg/s]", "time": "t[ms]"}``; in bags ``imu``,
        ``gnss`` and ``odometry`` -> topic. An empty name: nothing is read for this quantity. What is not named is found
        by names, units from names and values; ``columns`` and ``notes`` of the drive say how.

    Returns
    -------
    DriveLog

    Raises
    ------
    BadInputError
        A file cannot be read, or does not hold a drive.
    UsageError
        ``columns`` names something that is no quantity, or an extra is not installed.
    """
    wanted = dict(columns or {})
    unknown_quantities(wanted, (*QUANTITIES, *TOPICS))
    paths = drive_files(place)
    if not can_start_children():
        return _read(paths, wanted)
    size = sum(map(size_of, chain.from_iterable(bag_files(path) if is_bag(path) else [path] for path in paths)))
    seconds, memory = SECONDS + SECONDS_PER_BYTE * size, _MEMORY + _MEMORY_PER_BYTE * size
    enough = (free_memory() or 0) >= memory
    try:
        with _lock:
            log, error = _guard.call("read_in_child", paths, wanted, str(Path.cwd()), seconds=seconds, memory=memory)
    except DecoderError as refusal:
        raise BadInputError(f"cannot read {place}: {refusal}. {_COPY_AGAIN}") from refusal
    if error is not None and enough and missing_resource(error) == "memory":
        raise BadInputError(f"cannot read {place}: it needs more memory than its size explains. {_COPY_AGAIN}")
    if error is not None:
        raise error
    read: DriveLog = log
    return read


def close_log_reader() -> None:
    """End the process that reads logs; the next one starts it again."""
    with _lock:
        _guard.end()


def read_in_child(
    paths: Sequence[Path], wanted: Mapping[str, str], folder: str
) -> tuple[DriveLog | None, Exception | None]:
    """Read files of a drive, named relative to a folder, in the child; return it, or the error for the parent."""
    os.chdir(folder)
    # The allocator of pyarrow would reserve as much as the limit on memory allows.
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"
    try:
        return _read(paths, wanted), None
    except Exception as error:  # noqa: BLE001 (the parent raises it)
        if not isinstance(error, BumpymapError):
            error.add_note(format_exc())
        return None, error


def _read(paths: Sequence[Path], wanted: Mapping[str, str]) -> DriveLog:
    """Read files of a drive. All errors name them."""
    name = _name([path.stem for path in paths])
    try:
        return assemble(name, paths, _sources(paths, wanted))
    except BadInputError as error:
        if any(
            re.search(rf"(?<!\w){re.escape(each)}(?!\w)", str(error)) for each in {name, *(path.name for path in paths)}
        ):
            raise
        raise BadInputError(f"{', '.join(map(str, paths))}: {error}") from error


def _name(stems: Sequence[str]) -> str:
    """Return what the names of files have in common, such as "monday" of monday_imu and monday_gnss; else all."""
    if len(stems) == 1:
        return stems[0]
    words = [re.split(r"(?<=[^0-9A-Za-z])|(?=[^0-9A-Za-z])", stem) for stem in stems]
    common = list(takewhile(lambda each: len(set(each)) == 1, zip(*words, strict=False)))
    shared = "".join(each[0] for each in common).rstrip(" _-.,+")
    return shared or ",".join(stems)


def drive_files(place: str) -> list[Path]:
    """Return the files of a drive, given as to `read_drive`; a comma in the name of an existing file separates nothing.

    Raises
    ------
    BadInputError
        A file is not there, or is a folder that is no bag.
    UsageError
        No file is named.
    """
    if not place.strip():
        raise UsageError("the name of a drive is empty. Give a file, the folder of a bag, or files joined by commas")
    whole = Path(place)
    paths = [whole] if whole.exists() else [Path(part.strip()) for part in place.split(",") if part.strip()]
    for path in paths:
        if not path.exists():
            raise BadInputError(f"there is no file {path}. Check the path of the drive")
        if path.is_dir() and not is_bag(path):
            raise BadInputError(
                f"{path} is a folder, but no bag: it has no metadata.yaml. Give the files of one drive, joined by "
                f"commas, or make one for a bag: ros2 bag reindex {path}"
            )
    return paths


def _sources(paths: Sequence[Path], wanted: Mapping[str, str]) -> list[DriveSignals]:
    """Read the signals of all files."""
    for path in paths:
        if path.suffix.lower() in {".bin", ".log"}:
            refuse_binary(path)
    bags = [path for path in paths if is_bag(path) or is_ros1(path)]
    logs = [path for path in paths if is_ulog(path)]
    tables = [open_table(path) for path in paths if path not in {*bags, *logs}]
    topics = {quantity: name for quantity, name in wanted.items() if quantity in TOPICS}
    if topics and not bags:
        raise BadInputError(f"`columns` names topics ({', '.join(topics)}), and {paths[0]} is no bag. Leave them out")
    return [
        *_of_tables(tables, {quantity: name for quantity, name in wanted.items() if quantity not in TOPICS}),
        *(bag_signals(bags, topics) if bags else []),
        *(signals for path in logs for signals in ulog_signals(path)),
    ]


def _of_tables(tables: Sequence[TextTable], wanted: Mapping[str, str]) -> list[DriveSignals]:
    found = [find_columns(table, wanted) for table in tables]
    known = {quantity for each in found for quantity in each}
    missing = [quantity for quantity, text in wanted.items() if text and quantity not in known]
    if missing:
        listed = "; ".join(f"{table.path.name}: {', '.join(table.head.names)}" for table in tables)
        shown = ", ".join(f"{quantity}={wanted[quantity]}" for quantity in missing)
        raise BadInputError(
            f"`columns` names {shown}, which is not there. "
            + (f"Columns of {listed}" if tables else "Columns are named for tables of text, topics for bags")
        )
    return [table_signals(table, each) for table, each in zip(tables, found, strict=True)]


def _reset_after_fork() -> None:
    global _lock  # noqa: PLW0603 (another thread may have held it)
    _lock = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_reset_after_fork)
