"""Read a recorded drive from files of any format."""

import re
from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path

from bumpymap.core import BadInputError, DriveLog, UsageError
from bumpymap.readers.drives.ardupilot import refuse_binary
from bumpymap.readers.drives.assemble import assemble
from bumpymap.readers.drives.bag_signals import bag_signals
from bumpymap.readers.drives.choice import TOPICS, unknown_quantities
from bumpymap.readers.drives.quantities import QUANTITIES
from bumpymap.readers.drives.ros1_bag import is_ros1
from bumpymap.readers.drives.signals import DriveSignals
from bumpymap.readers.drives.table_signals import find_columns, table_signals
from bumpymap.readers.drives.text_table import TextTable, open_table
from bumpymap.readers.drives.ulog_signals import is_ulog, ulog_signals
from bumpymap.readers.frames.bag import is_bag

__all__ = ["read_drive"]


def read_drive(place: str, columns: Mapping[str, str] | None = None) -> DriveLog:
    """Read what the sensors of a vehicle recorded on a drive.

    Parameters
    ----------
    place : str
        A file, the folder of a bag, or several files of one drive joined by commas, in any order:
        ``imu.csv,gnss.csv``. CSV and other tables of text, bags of ROS 2 and ROS 1, ULog.
    columns : mapping, optional
        Quantity -> column, perhaps with its unit: ``{"rate_y": "GyrY[deg/s]", "time": "t[ms]"}``; in bags ``imu``,
        ``gnss`` and ``odometry`` -> topic. An empty name: nothing is read for this quantity. What is not named is told
        from names, units from names and values; ``columns`` and ``notes`` of the drive say how.

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
    paths = _paths(place)
    return assemble(_name([path.stem for path in paths]), paths, _sources(paths, wanted))


def _name(stems: Sequence[str]) -> str:
    """Return what the names of files have in common, such as "monday" of monday_imu and monday_gnss; else all."""
    if len(stems) == 1:
        return stems[0]
    words = [re.split(r"(?<=[^0-9A-Za-z])|(?=[^0-9A-Za-z])", stem) for stem in stems]
    common = list(takewhile(lambda each: len(set(each)) == 1, zip(*words, strict=False)))
    shared = "".join(each[0] for each in common).rstrip(" _-.,+")
    return shared or ",".join(stems)


def _paths(place: str) -> list[Path]:
    """Return the files that a text names; a comma in the name of an existing file separates nothing."""
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
