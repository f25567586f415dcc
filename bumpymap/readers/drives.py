"""Read a recorded drive, in a process of its own: tables, bags of ROS 2 and ROS 1, and ULog files."""

import io
import os
import re
import threading
from array import array
from collections.abc import Callable, Mapping, Sequence
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
    Floats,
    Guard,
    UsageError,
    free_memory,
    install_command,
    missing_resource,
)
from bumpymap.readers.drive_signals import (
    ACCELERATIONS,
    DOWN,
    LOCAL,
    LONLAT,
    QUATERNION,
    RATES,
    TOPICS,
    Samples,
    assemble,
    unknown_quantities,
)
from bumpymap.readers.drive_tables import find_columns, open_table, refuse_large, table_samples
from bumpymap.readers.raw_scans import BagReader, bag_files, choose_topic, held_topics, is_bag, is_ros1
from bumpymap.readers.source import decoding, open_source, size_of


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
        for topic, time_ns, data in bag.messages(set(roles) & set(bag.topics)):
            message = bag.decode(data, held[topic][0])
            stamp = message.header.stamp
            nanoseconds = stamp.sec * 1_000_000_000 + stamp.nanosec or time_ns
            rows[topic].append(nanoseconds * 1e-9)
            rows[topic].extend(_READ[roles[topic]][1](message))
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


_ARDUPILOT = b"\xa3\x95"
"""First bytes of every message of its binary logs."""
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

    ``place``: a file, the folder of a bag, or several files of one drive joined by commas, in any
    order: ``imu.csv,gnss.csv``. CSV and other tables of text, bags of ROS 2 and ROS 1, ULog;
    ``columns``: quantity -> column, perhaps with its unit: ``{"rate_y": "GyrY[deg/s]", "time":
    "t[ms]"}``; in bags ``imu``, ``gnss`` and ``odometry`` -> topic. An empty name: nothing is read
    for this quantity. Others are columns that have the names of
    `bumpymap.readers.drive_signals.NAMES`; ``columns`` and ``notes`` of the drive say which.
    Raises BadInputError: a file cannot be read, or does not hold a drive; UsageError: ``columns``
    names something that is no quantity, or an extra is not installed.
    """
    wanted = dict(columns or {})
    unknown_quantities(wanted)
    paths = drive_files(place)
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
        names = {name, *(path.name for path in paths)}
        if any(re.search(rf"(?<!\w){re.escape(each)}(?!\w)", str(error)) for each in names):
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

    Raises BadInputError: a file is not there, or is a folder that is no bag; UsageError: no file is
    named.
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


def _sources(paths: Sequence[Path], wanted: Mapping[str, str]) -> list[Samples]:
    """Read the samples of all files."""
    bags = [path for path in paths if is_bag(path) or is_ros1(path)]
    logs = [path for path in paths if path.suffix.lower() in {".ulg", ".ulog"}]
    texts = [path for path in paths if path not in {*bags, *logs}]
    for path in texts:
        _refuse_ardupilot(path)
    tables = [open_table(path) for path in texts]
    topics = {quantity: name for quantity, name in wanted.items() if quantity in TOPICS}
    if topics and not bags:
        raise BadInputError(f"`columns` names topics ({', '.join(topics)}), and {paths[0]} is no bag. Leave them out")
    named = {quantity: name for quantity, name in wanted.items() if quantity not in TOPICS}
    columns = [find_columns(table, named) for table in tables]
    known = set(chain.from_iterable(columns))
    missing = [f"{quantity}={text}" for quantity, text in named.items() if text and quantity not in known]
    if missing:
        listed = "; ".join(f"{table.path.name}: {', '.join(table.names)}" for table in tables)
        raise BadInputError(
            f"`columns` names {', '.join(missing)}, which is not there. "
            + (f"Columns of {listed}" if tables else "Columns are named for tables of text, topics for bags")
        )
    return [
        *map(table_samples, tables, columns),
        *(bag_samples(bags, topics) if bags else []),
        *(samples for path in logs for samples in ulog_samples(path)),
    ]


def _refuse_ardupilot(path: Path) -> None:
    """Raise BadInputError for the binary logs of ArduPilot, whose readers cannot be shipped with bumpymap."""
    with open_source(path) as stream:
        if stream.read(len(_ARDUPILOT)) != _ARDUPILOT:
            return
    raise BadInputError(
        f"{path} is a binary log of ArduPilot, which is not read itself. Make CSV files of it with pymavlink: "
        f"mavlogdump.py --format csv --types IMU {path.name} > {path.stem}_imu.csv, the same with --types GPS > "
        f"{path.stem}_gps.csv, and give {path.stem}_imu.csv,{path.stem}_gps.csv"
    )


def _reset_after_fork() -> None:
    global _lock  # noqa: PLW0603 (another thread may have held it)
    _lock = threading.Lock()


os.register_at_fork(after_in_child=_reset_after_fork)
