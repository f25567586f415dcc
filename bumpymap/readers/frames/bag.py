"""Read the messages of ROS 2 bags (``.mcap``, ``.db3``, or a folder with ``metadata.yaml``), one at a time."""

import weakref
from collections.abc import Collection, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

from bumpymap.core import BadInputError, BagMessage, UsageError
from bumpymap.readers.source import Version, asks_too_much, decoding, read_range, require_unchanged, size_of, version_of

__all__ = ["BAG_SUFFIXES", "CLOUD", "BagReader", "BagRecord", "bag_files", "is_bag", "message_types"]

BAG_SUFFIXES = (".mcap", ".db3")
CLOUD = "sensor_msgs/msg/PointCloud2"
_METADATA = "metadata.yaml"
_NOT_IN_A_URI = "%?#"
"""rosbags opens databases as URIs, and leaves these as they are."""
_AHEAD = 8
"""A message at most so many places further on is reached by reading on, which needs no index. Else it is looked up."""


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag: a file with its suffix, or a folder with its metadata."""
    return path.suffix.lower() in BAG_SUFFIXES if not path.is_dir() else (path / _METADATA).is_file()


def bag_files(path: Path) -> list[Path]:
    """Return the files that make up a bag, and the pipes in its folder, for `version_of` to refuse."""
    if not path.is_dir():
        return [path]
    there = (file for file in path.iterdir() if file.exists() and not file.is_dir())
    stored = (
        file for file in there if not file.is_file() or file.name.lower().removesuffix(".zstd").endswith(BAG_SUFFIXES)
    )
    return [path / _METADATA, *sorted(stored)]


def message_types() -> Any:
    """Return the message types of ROS 2, as rosbags knows them.

    Raises
    ------
    UsageError
        The extra ``ros`` is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise UsageError(
            f"bags are read with rosbags, which cannot be imported ({error}): pip install 'bumpymap[ros]'"
        ) from error
    return get_typestore(Stores.ROS2_HUMBLE)


@dataclass(frozen=True, slots=True)
class BagRecord:
    """A message as the bag stores it."""

    topic: str
    time_ns: int
    """Time under which it is stored."""
    data: bytes
    """CDR."""


class BagReader:
    """An open bag; it is closed when the object is collected. Several threads may `read`.

    Parameters
    ----------
    path : Path
        A file or a folder, see `is_bag`.

    Raises
    ------
    BadInputError
        The bag cannot be read.
    UsageError
        The extra ``ros`` is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._types = message_types()
        self._versions: dict[Path, Version] = {file: version_of(file) for file in bag_files(path)}
        self._lock = Lock()
        self._streams: list[Generator[BagRecord, None, None]] = []  # at most one: where `read` has got to
        self._next: tuple[str, int] = ("", 0)
        for file in self._versions:
            _refuse_database(file)
        with _reading(path):
            from rosbags.rosbag2 import Reader

            self._reader = Reader(path)
            self._reader.open()
            weakref.finalize(self, _close, self._reader, self._streams)
            self.topics = {
                topic: (str(info.msgtype), int(info.msgcount)) for topic, info in self._reader.topics.items()
            }
            """Type and number of messages of each topic."""

    def messages(self, topics: Collection[str], start_ns: int | None = None) -> Generator[BagRecord, None, None]:
        """Yield the messages of some topics in order of time, holding one at a time.

        Raises
        ------
        BadInputError
            The bag is damaged.
        """
        return _records(self._reader, self.path, topics, start_ns)

    def read(self, message: BagMessage) -> Any:
        """Return a message, deserialised.

        Raises
        ------
        BadInputError
            The bag is damaged, or has changed since it was opened.
        """
        with self._lock:
            topic, number = self._next
            if topic != message.topic or not 0 <= message.number - number <= _AHEAD:
                number = message.number - message.place
                self._streams[:] = [self.messages([message.topic], message.time_ns)]
            self._next = ("", 0)  # if this fails, the stream ends, and the next message is looked up
            record = None
            for _ in range(message.number - number + 1):
                record = next(self._streams[0], None)
            self._next = (message.topic, message.number + 1)
            for file, version in self._versions.items():
                require_unchanged(file, version)
        if record is None or record.time_ns != message.time_ns:
            raise BadInputError(f"the bag {self.path} no longer has the message {message.number} of {message.topic}")
        return self.decode(record.data, CLOUD)

    def decode(self, data: bytes, kind: str) -> Any:
        """Deserialise a message. Raises BadInputError if it is damaged."""
        with _reading(self.path):
            return self._types.deserialize_cdr(data, kind)


def _records(
    reader: Any, path: Path, topics: Collection[str], start_ns: int | None
) -> Generator[BagRecord, None, None]:
    wanted = [connection for connection in reader.connections if connection.topic in topics]
    with _reading(path):
        for connection, time_ns, data in reader.messages(wanted, start=start_ns) if wanted else ():
            yield BagRecord(connection.topic, time_ns, bytes(data))


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
        if not asks_too_much(error, [path]):
            raise
        # Without its cause, which would be reported as a lack of memory.
        raise _damaged(path, "it declares a record that is larger than the memory") from None


def _damaged(path: Path, why: str) -> BadInputError:
    return BadInputError(
        f"cannot read the bag {path}: {why.strip().rstrip('.') or 'it is damaged'}. If the recording was cut off, mend "
        "it: mcap recover IN.mcap -o OUT.mcap, or ros2 bag reindex FOLDER; else copy it again"
    )


def _refuse_database(file: Path) -> None:
    """Refuse a database that would not be found, or that is shorter than its pages: SQLite would read zeros."""
    if file.suffix.lower() != ".db3":
        return
    odd = next((letter for letter in _NOT_IN_A_URI if letter in str(file.absolute())), None)
    if odd is not None:
        raise BadInputError(f"{file} cannot be opened by rosbags because of the '{odd}' in its path. Rename it")
    head = read_range(file, 0, 32).tobytes()
    if head.startswith(b"SQLite format 3"):
        page, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
        declared, held = (65_536 if page == 1 else page) * pages, size_of(file)
        if held < declared:
            raise _damaged(file, f"it has {held:,} bytes, and its header declares {declared:,}")
