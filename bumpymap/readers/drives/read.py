"""Read a recorded drive from files of any format, in a process of its own."""

import os
import re
import threading
from collections.abc import Mapping, Sequence
from itertools import chain, takewhile
from pathlib import Path
from traceback import format_exc

from bumpymap.core import (
    BadInputError,
    BumpymapError,
    Child,
    DecoderError,
    DriveLog,
    Guard,
    UsageError,
    free_memory,
    missing_resource,
)
from bumpymap.readers.drives.quantities import TOPICS, unknown_quantities
from bumpymap.readers.drives.recordings import bag_samples, is_ulog, ulog_samples
from bumpymap.readers.drives.signals import Samples, assemble
from bumpymap.readers.drives.tables import find_columns, open_table, table_samples
from bumpymap.readers.frames.raw import bag_files, is_bag, is_ros1
from bumpymap.readers.source import open_source, size_of

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
    `bumpymap.readers.drives.quantities.NAMES`; ``columns`` and ``notes`` of the drive say which.
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
    logs = [path for path in paths if is_ulog(path)]
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
