"""All returns of scans, before any are dropped: from KITTI, PLY and PCD files, and from messages of ROS 2 bags.

Bags are ``.mcap``, ``.db3``, or a folder with ``metadata.yaml``; their messages are read one at a time.
"""

import weakref
from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, BagMessage, UsageError, install_command, short_repr
from bumpymap.readers.detect import read_columns
from bumpymap.readers.source import Version, asks_too_much, decoding, read_range, require_unchanged, size_of, version_of

BAG_SUFFIXES = (".mcap", ".db3")
CLOUD = "sensor_msgs/msg/PointCloud2"
_METADATA = "metadata.yaml"
_AHEAD = 8
"""A message at most this number of places on is reached by reading on, which needs no index. Else it is looked up."""


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag: a file with its suffix, or a folder with its metadata."""
    return path.suffix.lower() in BAG_SUFFIXES if not path.is_dir() else (path / _METADATA).is_file()


def is_ros1(path: Path) -> bool:
    """Return whether a path is a bag of ROS 1, by its suffix."""
    return path.suffix.lower() == ".bag" and not path.is_dir()


def bag_files(path: Path) -> list[Path]:
    """Return the files that make up a bag, and the pipes in its folder, for `version_of` to refuse."""
    if not path.is_dir():
        return [path]
    there = (file for file in path.iterdir() if file.exists() and not file.is_dir())
    stored = (
        file for file in there if not file.is_file() or file.name.lower().removesuffix(".zstd").endswith(BAG_SUFFIXES)
    )
    return [path / _METADATA, *sorted(stored)]


def held_topics(bags: Sequence["BagReader"]) -> dict[str, tuple[str, int]]:
    """Return type and number of messages of each topic that any of some bags holds."""
    held: dict[str, tuple[str, int]] = {}
    for bag in bags:
        for topic, (kind, count) in bag.topics.items():
            held[topic] = (kind, count + held.get(topic, (kind, 0))[1])
    return held


def choose_topic(
    held: Mapping[str, tuple[str, int]], kinds: Sequence[str], wanted: str | None, hint: str
) -> str | None:
    """Return the wanted topic, or the only one of the first of some types that has any; None if there is none.

    ``hint``: how to name a topic, ``{}`` in the place of one. Raises BadInputError: the wanted one is not there,
    or several may be meant.
    """
    of_type = {kind: [topic for topic in sorted(held) if held[topic][0] == kind] for kind in kinds}
    if wanted is not None and any(wanted in topics for topics in of_type.values()):
        return wanted
    kind, found = next(((kind, topics) for kind, topics in of_type.items() if topics), ("", []))
    if wanted is None and len(found) < 2:
        return next(iter(found), None)
    what = f"has no topic {wanted}" if wanted is not None else "holds several topics"
    listed = ", ".join(f"{topic} ({held[topic][1]:,} messages)" for topics in of_type.values() for topic in topics)
    raise BadInputError(
        f"the bag {what} of type {kind if wanted is None else ' or '.join(kinds)}: {listed or 'none'}. "
        + hint.format(next(iter(found), "NAME"))
    )


BagRecord = tuple[str, int, bytes]
"""A message as the bag stores it: its topic, the time under which it is stored, ns, and it, serialised."""


class BagReader:
    """An open bag; it is closed when the object is collected. Several threads may `read`.

    ``path``: a file or a folder, see `is_bag`; or a file of ROS 1. Raises BadInputError: the bag
    cannot be read; UsageError: the extra ``ros`` is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        ros1 = is_ros1(path)
        try:
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise UsageError(
                f"bags are read with rosbags, which cannot be imported ({error}): {install_command('ros')}"
            ) from error
        types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        self._deserialize = types.deserialize_ros1 if ros1 else types.deserialize_cdr
        self._versions: dict[Path, Version] = {file: version_of(file) for file in bag_files(path)}
        self._lock = Lock()
        self._streams: list[Generator[BagRecord, None, None]] = []  # at most one: where `read` has got to
        self._next: tuple[str, int] = ("", 0)
        for file in self._versions:
            _refuse_database(file)
        with _reading(path):
            from rosbags import rosbag1, rosbag2

            self._reader: Any = rosbag1.Reader(path) if ros1 else rosbag2.Reader(path)
            self._reader.open()
            weakref.finalize(self, _close, self._reader, self._streams)
            self.topics = {
                topic: (str(info.msgtype), int(info.msgcount)) for topic, info in self._reader.topics.items()
            }
            """Type, as ROS 2 spells it, and number of messages of each topic."""

    def messages(self, topics: Collection[str], start_ns: int | None = None) -> Generator[BagRecord, None, None]:
        """Yield the messages of some topics in order of time, holding one at a time.

        Raises BadInputError: the bag is damaged.
        """
        wanted = [connection for connection in self._reader.connections if connection.topic in topics]
        return _records(self._reader, self.path, wanted, start_ns)

    def read(self, message: BagMessage) -> Any:
        """Return a message, deserialised.

        Raises BadInputError: the bag is damaged, or has changed since it was opened.
        """
        with self._lock:
            topic, number = self._next
            if topic != message.topic or not 0 <= message.number - number <= _AHEAD:
                number = message.number - message.place
                self._streams[:] = [self.messages([message.topic], message.time_ns)]
            self._next = ("", 0)  # if this fails, the stream ends, and the next message is looked up
            time_ns, data = None, b""
            for _ in range(message.number - number + 1):
                _, time_ns, data = next(self._streams[0], ("", None, b""))
            self._next = (message.topic, message.number + 1)
            for file, version in self._versions.items():
                require_unchanged(file, version)
        if time_ns != message.time_ns:
            raise BadInputError(f"the bag {self.path} no longer has the message {message.number} of {message.topic}")
        return self.decode(data, CLOUD)

    def decode(self, data: bytes, kind: str) -> Any:
        """Deserialise a message. Raises BadInputError if it is damaged."""
        with _reading(self.path):
            return self._deserialize(data, kind)


def _records(reader: Any, path: Path, wanted: list[Any], start_ns: int | None) -> Generator[BagRecord, None, None]:
    # Not a method: a generator that holds its bag would keep it open.
    with _reading(path):
        for connection, time_ns, data in reader.messages(wanted, start=start_ns) if wanted else ():
            yield connection.topic, time_ns, bytes(data)


def _close(reader: Any, streams: list[Generator[BagRecord, None, None]]) -> None:
    """Close a bag; first what is being read from it, without which a ``.db3`` cannot be closed."""
    for stream in streams:
        stream.close()
    streams.clear()
    reader.close()


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn the exceptions of rosbags and of its libraries, which differ, into BadInputError."""
    try:
        with decoding(path, "the bag"):
            yield
    except BadInputError as error:
        if error.__cause__ is None:  # of our own
            raise
        raise _damaged(path, str(error.__cause__)) from error.__cause__
    except Exception as error:
        if not asks_too_much(error, path):
            raise
        # Without its cause, which would be reported as a lack of memory.
        raise _damaged(path, "it declares a record that is larger than the memory") from None


def _damaged(path: Path, why: str) -> BadInputError:
    return BadInputError(
        f"cannot read the bag {path}: {why.strip().rstrip('.') or 'it is damaged'}. If the recording was cut off, mend "
        "it: mcap recover IN.mcap -o OUT.mcap, or ros2 bag reindex FOLDER; else copy it again"
    )


def _refuse_database(file: Path) -> None:
    """Refuse a database that is shorter than its pages: SQLite would read zeros."""
    if file.suffix.lower() != ".db3":
        return
    head = read_range(file, 0, 32).tobytes()
    if head.startswith(b"SQLite format 3"):
        page, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
        declared, held = (65_536 if page == 1 else page) * pages, size_of(file)
        if held < declared:
            raise _damaged(file, f"it has {held:,} bytes, and its header declares {declared:,}")


TIME_COLUMNS = ("t", "time", "timestamp", "offset_time", "time_stamp", "timestamps", "scalar_timestamp", "scalar_time")
"""Names, in lower case, of columns with the time of each point."""
_WANTED = {
    "label": ("label", "labels", "scalar_label", "semantic", "semantic_label", "sem_id"),
    "intensity": ("intensity", "scalar_intensity", "reflectivity", "remission"),
    "time": TIME_COLUMNS,
}
_MOST_ID = 65_535
"""Highest semantic id: labels of SemanticKITTI have 16 bits."""


@dataclass(frozen=True, slots=True)
class RawScan:
    """All returns of a scan file, in order."""

    points: NDArray[np.float32]
    """(n, 3) m; (0, 0, 0) for a beam without return; may hold NaN, infinity or any other value."""
    intensity: NDArray[np.float32] | None
    """(n,)"""
    label: NDArray[np.uint16] | None
    """(n,) semantic ids."""
    time: NDArray[np.float32] | None = None
    """(n,) s, see `bumpymap.core.Scan`; NaN if unknown."""


def read_table(path: Path) -> RawScan:
    """Read a PLY or PCD scan; a column ``label`` holds the semantic ids."""
    columns = read_columns(path, _WANTED)
    with np.errstate(over="ignore", invalid="ignore"):  # non-finite points are dropped and counted later
        points = np.stack([columns[axis].astype(np.float32) for axis in "xyz"], axis=1)
        intensity = columns["intensity"].astype(np.float32) if "intensity" in columns else None
    ids = columns["label"].astype(np.float64) if "label" in columns else None
    if ids is not None and not ((ids >= 0) & (ids <= _MOST_ID) & (ids == np.rint(ids))).all():
        raise BadInputError(f"the labels of {path} are not all whole numbers from 0 to {_MOST_ID:,}: not semantic ids")
    return RawScan(
        points,
        intensity,
        None if ids is None else ids.astype(np.uint16),
        point_seconds(columns["time"])[0] if "time" in columns else None,
    )


_UNITS_S = (1.0, 1e-6, 1e-9)
"""Seconds, microseconds, nanoseconds."""
_SPAN_S = (0.005, 2.0)
"""Time that a scan takes: a revolution at 5 to 20 Hz and its parts, or several. Within these limits no time fits two
units."""
_EPOCH_S = 1e8
"""Later than this (1973) is a time of day and not one since the sensor was switched on."""


def point_seconds(column: NDArray[Any]) -> tuple[NDArray[np.float32] | None, float | None]:
    """Return the time of each point, s, and the first of times of day, s since 1970.

    ``column`` (n,) array of numbers: times in s, us or ns, after the time of the frame or of day;
    may hold values that are not finite. Returns (n,) float32 or None: after the time of the frame,
    as in the file; of times of day: after the first of them. None if the unit is not clear: a scan
    takes 5 ms to 2 s. NaN where a time is not finite, or 0 among times of day: some drivers write 0
    for beams without return. The first time is None if these are no times of day.
    """
    times = np.where(np.isfinite(column), column, np.nan).astype(np.float64)
    stamped = times[~np.isnan(times) & (times != 0.0)]
    span = float(np.ptp(stamped)) if len(stamped) else 0.0
    unit = next((unit for unit in _UNITS_S if _SPAN_S[0] <= span * unit <= _SPAN_S[1]), None)
    if unit is None:
        return None, None
    seconds, first = times * unit, float(stamped.min())
    if np.nanmax(np.abs(seconds)) > _SPAN_S[1]:
        seconds = np.where(times == 0.0, np.nan, times - first) * unit
    return seconds.astype(np.float32), first * unit if first * unit > _EPOCH_S else None


_ATTRIBUTES = ("height", "width", "point_step", "row_step", "is_bigendian", "fields", "data")
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Types of numpy of the constants in sensor_msgs/PointField."""
_INTENSITY = ("intensity", "intensities", "reflectivity")
"""Names of fields with the strength of the return; the first one that is there is taken."""
_SAME_CLOCK_S = 2.0
"""Times of points and of the header that are farther apart are of different clocks: no scan takes longer."""


def points_of(message: Any) -> NDArray[np.float32]:
    """Return the points of a message.

    Parameters
    ----------
    message : sensor_msgs/PointCloud2
        From rclpy, rosbags or any other library with the same names of attributes.

    Returns
    -------
    (n, 3) float32
        x, y and z of all returns, m, also of those that are NaN; of an organised cloud row by row.

    Raises
    ------
    BadInputError
        The message has no x, y and z, or less data than it declares.
    UsageError
        This is no such message.
    """
    missing = [name for name in _ATTRIBUTES if not hasattr(message, name)]
    if missing:
        raise UsageError(
            f"message is {short_repr(message)}, without {', '.join(missing)}; give a message sensor_msgs/PointCloud2"
        )
    return _xyz(_rows(message))


def read_cloud(message: Any) -> RawScan:
    """Read all returns of a message: points and, if there are fields for them, intensity and time.

    Times of day count from the time in the header, if they are near to it, else from the first.

    Raises BadInputError: see `points_of`.
    """
    rows = _rows(message)
    held = rows.dtype.names or ()
    intensity, time = (
        next((rows[name].ravel() for name in names if name in held), None) for names in (_INTENSITY, TIME_COLUMNS)
    )
    seconds, start = (None, None) if time is None else point_seconds(time)
    if seconds is not None:
        stamp = message.header.stamp
        late = 0.0 if start is None else start - (stamp.sec + 1e-9 * stamp.nanosec)
        seconds += np.float32(late if abs(late) < _SAME_CLOCK_S else 0.0)
    return RawScan(_xyz(rows), None if intensity is None else intensity.astype(np.float32), None, seconds)


def _xyz(rows: NDArray[np.void]) -> NDArray[np.float32]:
    points = np.empty((*rows.shape, 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is dropped and counted later
        for column, axis in enumerate("xyz"):
            points[..., column] = rows[axis]
    return points.reshape(-1, 3)


def _rows(message: Any) -> NDArray[np.void]:
    """Return a view of the points, (height, width), with the fields that hold one number each."""
    height, width, step = int(message.height), int(message.width), int(message.point_step)
    order = ">" if message.is_bigendian else "<"
    fields = {
        str(field.name): (np.dtype(order + _TYPES[int(field.datatype)]), int(field.offset))
        for field in message.fields
        if int(field.datatype) in _TYPES and int(field.count) <= 1
    }
    missing = [axis for axis in "xyz" if axis not in fields]
    outside = [name for name, (kind, offset) in fields.items() if offset + kind.itemsize > step]
    if missing or outside:
        names = ", ".join(str(field.name) for field in message.fields) or "none"
        what = (
            f"has no {', '.join(missing)}" if missing else f"declares {outside[0]} outside of its {step} bytes a point"
        )
        raise BadInputError(f"the point cloud {what}; its fields are {names}. x, y and z are needed, a number each")
    data = np.frombuffer(message.data, np.uint8)
    pitch = int(message.row_step) if height > 1 else width * step
    needed = (height - 1) * pitch + width * step if height and width else 0
    if pitch < width * step or needed > data.size:
        raise BadInputError(
            f"the point cloud declares {height:,} x {width:,} points of {step} bytes, in rows of {message.row_step:,} "
            f"bytes, and holds {data.size:,} bytes of data. The message is damaged or its driver is faulty"
        )
    kinds, offsets = zip(*fields.values(), strict=True)
    dtype = np.dtype({"names": list(fields), "formats": kinds, "offsets": offsets, "itemsize": step})
    return np.ndarray((height, width) if needed else (0, 0), dtype, data, strides=(pitch, step))
