"""Find the scans that the user named, in time order, and read their points; returns of nothing are dropped.

KITTI-style scans are ``.bin`` files of float32 x, y, z, intensity, with ``.label`` files of uint32. The lower 16 bits
of a label are the semantic id. The label file of ``DIR/NAME.bin`` is in the same folder, or in a folder beside ``DIR``:
``labels`` (SemanticKITTI) or ``os1_cloud_node_semantickitti_label_id`` (RELLIS-3D).

*Deskewing* (``deskewing.cpp``): a sensor that moves while it scans has its points moved to where it sees them at the
time of the frame.
"""

import logging
import os
import re
import shlex
import struct
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import SCAN_S, BadInputError, BagMessage, Dropped, Frame, PoseTrack, Robot, Scan, UsageError, loops
from bumpymap.readers.detect import files_at
from bumpymap.readers.raw_scans import (
    BAG_SUFFIXES,
    CLOUD,
    BagReader,
    RawScan,
    choose_topic,
    held_topics,
    is_bag,
    point_seconds,
    read_cloud,
    read_table,
)
from bumpymap.readers.source import NoPointsError, pinned_version, read_range, refuse_count, size_of, version_of
from bumpymap.readers.transforms import FIXED_FRAMES, FrameTree, Trajectory, frame_name, seconds_since

_log = logging.getLogger(__name__)

_ODOMETRY, _TF = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"


@dataclass(frozen=True, slots=True)
class BagTopics:
    """Topics of a bag that are read."""

    clouds: tuple[str, ...] = ()
    """Of the scans, one for each sensor; none: the only one of its type."""
    odometry: str | None = None
    """Of the odometry; None: the only one of its type, or else the transforms."""
    poses: bool = True
    """True if poses are read."""


def find_messages(paths: Sequence[Path], topics: BagTopics) -> list[Frame]:
    """Find the scans in bags, in order of time, with their poses if the bags hold any.

    Every message of the topics is read once, one at a time.

    Raises BadInputError: a bag is damaged, the topic is not there or not clear, or the wanted
    odometry gives no poses; UsageError: the extra ``ros`` is not installed.
    """
    bags = [BagReader(path) for path in paths]
    held = held_topics(bags)
    clouds = [_choose(held, CLOUD, cloud, "topic") for cloud in topics.clouds or (None,)]
    recorded = _Poses(held if topics.poses else {}, topics.odometry)
    sources = [
        Frame(bag.path, message) for bag in bags for message in _messages(bag, clouds, recorded) if message.bytes
    ]
    if not sources:
        raise BadInputError(
            f"the topic {', '.join(clouds)} of {paths[0]} holds no messages. Was the sensor switched on?"
        )
    return recorded.add_poses(sources) if topics.poses else sources


def _choose(held: Mapping[str, tuple[str, int]], kind: str, wanted: str | None, setting: str) -> str:
    """Return the topic of a type: the wanted one, or the only one."""
    kinds = {each for each, _ in held.values()}
    if kind not in kinds:
        raise BadInputError(f"the bag holds no topic of type {kind}; it holds {', '.join(sorted(kinds)) or 'nothing'}")
    also = ", or those of several sensors: NAME,NAME" if kind == CLOUD else ""
    return choose_topic(held, (kind,), wanted, f"Name one of these with `{setting}='{{}}'`{also}") or ""


def _messages(bag: BagReader, clouds: Collection[str], recorded: "_Poses") -> Iterable[BagMessage]:
    at = dict.fromkeys(clouds, (-1, 0, -1))  # number, place and time of the last message
    for topic, time_ns, data in bag.messages({*clouds, *recorded.topics} & set(bag.topics)):
        if topic not in at:
            recorded.add(bag, topic, data)
            continue
        number, place, last = at[topic]
        number, place = number + 1, place + 1 if time_ns == last else 0
        at[topic] = number, place, time_ns
        try:  # the header alone: points stay as they are
            order = "<" if data[1] & 1 else ">"  # of the encapsulation
            seconds, rest, length = struct.unpack_from(f"{order}iII", data, 4)
            frame = data[16 : 16 + length].rstrip(b"\0").decode()
        except (IndexError, struct.error, UnicodeDecodeError) as error:
            raise BadInputError(
                f"message {number} of {topic} in {bag.path} has no valid header ({error}). The bag is damaged: "
                "copy it again"
            ) from error
        stamp = seconds * 1_000_000_000 + rest
        yield BagMessage(topic, number, time_ns, place, stamp or time_ns, frame_name(frame), len(data))


class _Poses:
    """The poses of the sensor, collected while a bag is read."""

    def __init__(self, held: Mapping[str, tuple[str, int]], wanted: str | None) -> None:
        self._wanted = wanted
        self._several = sorted(topic for topic, (kind, _) in held.items() if kind == _ODOMETRY)
        is_clear = wanted or len(self._several) == 1
        self._odometry = _choose(held, _ODOMETRY, wanted, "odometry") if is_clear else None
        self._transforms = {topic for topic, (kind, _) in held.items() if kind == _TF}
        self._tree, self._trajectory = FrameTree(), Trajectory(str(self._odometry))
        self._base: str | None = None
        self._fixed = ""

    @property
    def topics(self) -> Collection[str]:
        """Topics to read."""
        return self._transforms | ({self._odometry} if self._odometry else set())

    def add(self, bag: BagReader, topic: str, data: bytes) -> None:
        """Add a message of one of the topics."""
        if topic in self._transforms:
            self._tree.add(bag.decode(data, _TF), static=topic.endswith("static"))
            return
        message = bag.decode(data, _ODOMETRY)
        self._base, self._fixed = frame_name(message.child_frame_id), frame_name(message.header.frame_id)
        self._trajectory.add(message.header.stamp, message.pose.pose.position, message.pose.pose.orientation)

    def add_poses(self, sources: Sequence[Frame]) -> list[Frame]:
        """Return the sources with their poses and motions, as far as they are known."""
        placed, messages = list(sources), [source.message for source in sources if source.message is not None]
        for sensor in dict.fromkeys(message.frame_id for message in messages):
            own = [row for row, message in enumerate(messages) if message.frame_id == sensor]
            origin_ns = messages[own[0]].stamp_ns
            times = seconds_since(origin_ns, np.array([messages[row].stamp_ns for row in own]))
            try:
                track, fixed = self._track(sensor, origin_ns, times)
            except BadInputError as error:
                raise BadInputError(f"the poses in {sources[0].path} cannot be used: {error}") from error
            if track is None:
                continue
            known, poses = track.covers(times), track.at(times)
            if lost := len(known) - int(known.sum()):
                what = (
                    f"{lost:,} of {len(known):,} frames have no pose: relative to the first frame, frames span 0 to "
                    f"{times[-1]:.1f} s, the recorded poses {track.times[0]:.1f} to {track.times[-1]:.1f} s"
                )
                if self._wanted is not None and not known.any():
                    raise BadInputError(f"{what}. Are their headers from different clocks?")
                _log.warning("%s. Frames without a pose are classified, but not mapped", what)
            for row, time, pose, ok in zip(own, times.tolist(), poses, known, strict=True):
                if ok:
                    motion = track.around(time, SCAN_S)
                    placed[row] = replace(placed[row], pose=pose, motion=motion, pose_frame=fixed)
        return placed

    def _track(self, sensor: str, origin_ns: int, times: NDArray[np.float64]) -> tuple[PoseTrack | None, str]:
        """Return the poses of a sensor by odometry, or else by transforms, and their frame; None if there are none."""
        mount = None if self._base is None else self._tree.mount(self._base, sensor)
        if mount is not None:
            track = self._trajectory.track(origin_ns)
            return PoseTrack(track.times, track.poses @ mount), self._fixed
        if self._base is not None and self._wanted is not None:
            raise BadInputError(
                f"{self._odometry} moves the frame '{self._base}', and no static transform (/tf_static) says where the "
                f"sensor's frame '{sensor}' is on it. Record /tf_static too, or give poses of the sensor with "
                "`poses='FILE'`"
            )
        found = self._tree.track(sensor, origin_ns, times)
        if found is None:
            _log.warning(
                "the bag gives no poses: no transforms lead from the sensor's frame '%s' to one of %s, nor, with "
                "/tf_static, to that of the only odometry (topics: %s; name one of several with `odometry`). The "
                "frames are classified, but not mapped",
                sensor,
                " and ".join(FIXED_FRAMES),
                ", ".join(self._several) or "none",
            )
        return found, self._tree.fixed_frame(sensor) or ""


SUFFIXES = (".ply", ".pcd", ".bin")
"""File suffixes that a folder is searched for, in any case."""
_NUMBER = re.compile(r"(\d+)")


def find_sources(paths: Sequence[Path], topics: BagTopics) -> list[Frame]:
    """Return the scans at the given paths, in time order: files, as by `find_frames`, or messages in bags.

    ``paths``: files and folders of scans, or bags (``.mcap``, ``.db3``, folders with
    ``metadata.yaml`` or with such files); ``topics``: for bags alone. Several bags come in
    natural order of their paths. Raises BadInputError: a path does not exist, holds no scans, or a
    bag cannot be read or leaves open which topic is meant; UsageError: topics are given without a
    bag, bags are mixed with files of scans, or the extra ``ros`` is not installed.
    """
    bags = [bag for path in paths for bag in bags_at(path)]
    if not bags:
        if topics.clouds or topics.odometry:
            raise UsageError("`topic` and `odometry` choose topics of a bag, and no bag was given; leave them out")
        return [Frame(path) for path in find_frames(paths)]
    files = [path for path in paths if not bags_at(path)]
    if files:
        raise UsageError(f"{files[0]} and {bags[0]} were given; give files of scans or bags, not both")
    unique = {os.path.realpath(bag): bag for bag in reversed(bags)}
    return find_messages(sorted(unique.values(), key=natural_key), topics)


def bags_at(path: Path) -> list[Path]:
    """Return the bags at a path: itself, or the files of bags in a folder that lost its metadata; else none."""
    if path.suffix.lower() == ".bag" and path.is_file():
        raise BadInputError(f"{path} is a bag of ROS 1; convert it to one of ROS 2 first, with rosbags-convert")
    if is_bag(path):
        return [path] if path.exists() else []
    if not path.is_dir() or _scans(path):
        return []
    return [file for file in path.iterdir() if file.suffix.lower() in BAG_SUFFIXES and file.is_file()]


def find_frames(paths: Sequence[Path]) -> list[Path]:
    """Return the scan files at the given paths, in time order.

    ``paths``: files (with any suffix) and folders. If a folder holds no scans itself, its subfolder
    ``velodyne`` or ``os1_cloud_node_kitti_bin`` is searched, as in the KITTI and RELLIS-3D data
    sets. Hidden files are ignored. They come in natural order of their paths (``2.bin`` before
    ``10.bin``), whatever the order of ``paths``; each once. Raises BadInputError: a path does not
    exist, or a folder holds no scans or scans of several formats.
    """
    if not paths:
        raise BadInputError("no scan was given; name a file of a scan, or a folder of them")
    files = sorted(files_at(paths, _scans_in, "a file of a scan"), key=natural_key)
    _refuse_surveys(paths[0], files)
    return files


def _refuse_surveys(path: Path, files: Iterable[Path]) -> None:
    """Raise BadInputError if a file is a LAS or LAZ file: a survey."""
    if survey := next((file for file in files if file.suffix.lower() in {".las", ".laz"}), None):
        raise BadInputError(
            f"{survey} is a survey and no scan of a robot: bumpymap map {shlex.quote(str(path))} --out DIR maps it"
        )


def natural_key(path: Path) -> tuple[tuple[tuple[int, int | str], ...], ...]:
    """Return a sort key that compares numbers in names as numbers, and puts a folder before its contents."""
    return tuple(
        tuple((0, int(part)) if part.isdigit() else (1, part) for part in _NUMBER.split(name) if part)
        for name in path.parts
    )


def _scans_in(path: Path) -> list[Path]:
    for folder in (path, *(path / name for name in POINT_FOLDERS)):
        files = _scans(folder)
        kinds = sorted({file.suffix.lower() for file in files})
        if len(kinds) > 1:
            raise BadInputError(
                f"the folder {folder} holds scans of several formats ({', '.join(kinds)}): the same frames twice? Name "
                f"the files of one format, such as: {folder}/*{kinds[0]}"
            )
        if files:
            return files
    _refuse_surveys(path, path.iterdir())
    raise BadInputError(
        f"the folder {path} holds no scans; files ending in {', '.join(SUFFIXES)} are searched for, also in its "
        f"folders {' and '.join(POINT_FOLDERS)}, and bags ({', '.join(BAG_SUFFIXES)}). Name the folder that holds them"
    )


def _scans(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return [
        file
        for file in folder.iterdir()
        if file.suffix.lower() in SUFFIXES and not file.name.startswith(".") and file.is_file()
    ]


def read_scan(path: Path, robot: Robot | None = None, columns: int | None = None) -> Scan:
    """Read one scan: PLY, PCD, or KITTI-style ``.bin`` with its labels.

    ``robot``: returns on the robot are dropped; ``columns``: number of columns of a ``.bin`` file:
    4, 5 or 6; None: found from its values. The scan may have no points; its ``dropped`` counts
    the reasons. Raises BadInputError: the file cannot be read, is empty, truncated or of another
    format, changes while it is read, its labels do not match, or the number of its columns is in
    doubt.
    """
    version = version_of(path)
    with pinned_version(path, version):
        raw = read_kitti(path, columns) if path.suffix.lower() == ".bin" else read_table(path)
    return _keep_points(raw, robot or Robot(), path.stem)


def read_message(bag: BagReader, message: BagMessage, robot: Robot, name: str) -> Scan:
    """Read a scan from an open bag. Raises BadInputError if the message is damaged or holds no points."""
    try:
        return _keep_points(read_cloud(bag.read(message)), robot, name)
    except BadInputError as error:
        raise BadInputError(
            f"cannot read message {message.number} of {message.topic} in {bag.path}: {error}"
        ) from error


def scene_points(points: NDArray[np.float32], robot: Robot) -> NDArray[np.bool_]:
    """Return which returns (n, 3) are points of the scene, (n,): finite, not (0, 0, 0), not on the robot."""
    finite, nothing, on_robot = _return_kinds(points, robot)
    return finite & ~nothing & ~on_robot


def _return_kinds(
    points: NDArray[np.float32], robot: Robot
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which returns are finite, which are (0, 0, 0), and which of the others are on the robot."""
    x, y, z = np.ascontiguousarray(points.T)
    finite = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    nothing = (x == 0.0) & (y == 0.0) & (z == 0.0)
    on_robot = np.zeros(len(points), np.bool_)
    with np.errstate(over="ignore", invalid="ignore"):
        near = np.flatnonzero((np.abs(x) <= robot.radius_m) & (np.abs(y) <= robot.radius_m))
        on_robot[near] = np.hypot(x[near], y[near]) < robot.radius_m
        if robot.box_m is not None:
            rear, front, right, left = robot.box_m
            on_robot = on_robot | ((rear <= x) & (x <= front) & (right <= y) & (y <= left))
    return finite, nothing, on_robot & finite & ~nothing


def _keep_points(raw: RawScan, robot: Robot, name: str) -> Scan:
    finite, nothing, on_robot = _return_kinds(raw.points, robot)
    kept = finite & ~nothing & ~on_robot
    missing = nothing.sum() + np.isnan(raw.points[~finite]).all(axis=1).sum()
    time = None if raw.time is None else raw.time[kept]
    return Scan(
        np.ascontiguousarray(raw.points[kept], np.float32),
        None if raw.intensity is None else raw.intensity[kept].astype(np.float32),
        None if raw.label is None else raw.label[kept],
        name,
        Dropped(int(missing), int((~finite).sum() + nothing.sum() - missing), int(on_robot.sum())),
        time if time is not None and np.isfinite(time).all() else None,
    )


BIN_COLUMNS = {4: "x, y, z, intensity", 5: "x, y, z, intensity, ring", 6: "x, y, z, intensity, ring, time"}
"""Number of columns of a ``.bin`` scan -> what they are."""
POINT_FOLDERS = ("velodyne", "os1_cloud_node_kitti_bin")
"""Folders of ``.bin`` files inside a sequence."""
LABEL_FOLDERS = ("labels", "os1_cloud_node_semantickitti_label_id")
"""Folders of ``.label`` files, beside the folders of points."""
_MOST_RINGS = 1024
"""Beams of a LiDAR at most. Chosen: eight times those of any on the market."""
_FARTHEST_M = 1e4
"""Beyond the range of any LiDAR on a robot: larger coordinates mean that the file holds something else."""


def read_kitti(path: Path, columns: int | None = None) -> RawScan:
    """Read a ``.bin`` file, and its labels if there are any.

    ``columns``: 4 (x, y, z, intensity), 5 (and ring) or 6 (and time); None: found from the values.
    Raises BadInputError: the file is empty, truncated or not a scan, its number of columns is in
    doubt, or the label file does not match it.
    """
    size = size_of(path)
    if size == 0:
        raise NoPointsError(f"{path} is empty")
    if size % 4:
        raise BadInputError(
            f"{path} has {size:,} bytes, and a scan is one or more float32: it is truncated or not a KITTI-style scan. "
            "Copy it again, or convert it to PLY"
        )
    values = _whole(path, size).view("<f4")
    with np.errstate(invalid="ignore"):
        plausible = np.isnan(values) | (np.abs(values) < _FARTHEST_M) & ((values == 0.0) | (np.abs(values) > 1e-12))
    if plausible.mean() < 0.5:
        raise BadInputError(
            f"{path} does not hold float32 x, y, z, intensity: most of its values are not within {_FARTHEST_M:,.0f} m. "
            "Is it another kind of file?"
        )
    table = values.reshape(-1, _find_columns(path, values, columns))
    labels = label_file(path)
    ids = None if labels is None else _read_labels(labels, path, len(table))
    seconds = point_seconds(table[:, 5])[0] if table.shape[1] == 6 and _is_ring(table[:, 4]) else None
    return RawScan(table[:, :3], table[:, 3], ids, seconds)


def _find_columns(path: Path, values: NDArray[np.float32], columns: int | None) -> int:
    """Return the number of columns: what the user says, or the only one that size and values fit.

    Where the values fit no number, because of negative intensities or other columns, the user alone can tell.
    """
    fitting = [width for width in BIN_COLUMNS if len(values) % width == 0 and _fits(values.reshape(-1, width))]
    if columns is not None and len(values) % columns == 0 and (columns in fitting or not fitting):
        return columns
    if columns is None and (len(fitting) == 1 or (fitting and not np.nan_to_num(values).any())):
        return fitting[0]
    raise BadInputError(
        f"{path} holds {len(values):,} float32 values, which fit {' or '.join(map(str, fitting)) or 'none'} of 4, 5 or "
        f"6 columns ({'; '.join(f'{width}: {names}' for width, names in BIN_COLUMNS.items())}): "
        f"{'more than one' if columns is None and fitting else 'is it truncated, or of another kind'}? Say which they "
        "are with `columns`, copy it again, or convert it to PLY"
    )


def _fits(rows: NDArray[np.float32]) -> bool:
    """Return whether rows have an intensity of at least 0 and, if there are more columns, a ring.

    In rows of another width, coordinates stand there in some rows: these are below 0, or no whole numbers. If all rows
    are beams without return, there are no points that could be misread.
    """
    with np.errstate(invalid="ignore"):
        fits = bool((rows[:, 3] >= 0.0).all()) and (rows.shape[1] == 4 or _is_ring(rows[:, 4]))
    return fits or not np.nan_to_num(rows[:, :3]).any()


def _is_ring(column: NDArray[np.float32]) -> bool:
    with np.errstate(invalid="ignore"):
        return bool(((column >= 0.0) & (column < _MOST_RINGS) & (column == np.rint(column))).all())


def _whole(path: Path, size: int) -> NDArray[np.uint8]:
    data = read_range(path, 0, size)
    refuse_count(path, size, data.size, "bytes")
    return data


def label_file(path: Path) -> Path | None:
    """Return the label file of a ``.bin`` file; None if there is none."""
    name = f"{path.stem}.label"
    near = [path.parent / name, *(path.parent.parent / folder / name for folder in LABEL_FOLDERS)]
    return next((file for file in near if file.is_file()), None)


def _read_labels(labels: Path, path: Path, count: int) -> NDArray[np.uint16]:
    version = version_of(labels)
    size = version["size"]
    if size != 4 * count:
        raise BadInputError(
            f"{labels} has {size:,} bytes; {path} has {count:,} points, whose labels take {4 * count:,}. They do not "
            "belong together: copy both again, or remove the label file"
        )
    with pinned_version(labels, version):
        return (_whole(labels, size).view("<u4") & 0xFFFF).astype(np.uint16)


_STEP_S = 1e-3
"""Interval at which poses are computed. Points between them move along lines: at 3 rad/s, 0.1 mm off at 100 m."""


def deskew(scan: Scan, motion: PoseTrack) -> Scan:
    """Move the points of a scan to where they are seen from the pose at the time of the frame.

    ``scan``: with the time of each point; ``motion``: poses of the sensor; time 0 is that of the frame. Returns the
    same scan if it has no times, or if the poses do not cover them.
    """
    if scan.time is None or not len(scan.points):
        return scan
    start, end = float(scan.time.min()), float(scan.time.max())
    times = np.linspace(start, end, max(ceil((end - start) / _STEP_S), 1) + 1)
    if not motion.covers(np.append(times, 0.0)).all():
        return scan
    poses = motion.at(np.append(times, 0.0))
    relative = np.linalg.inv(poses[-1]) @ poses[:-1]
    moved = np.empty_like(scan.points)
    step = max(end - start, _STEP_S) / (len(times) - 1)
    transforms = np.ascontiguousarray(relative[:, :3])  # at times start, start + step and so on
    loops.move_points(scan.points, scan.time, transforms, start, step, moved)
    return replace(scan, points=moved)
