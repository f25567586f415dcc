"""Read the messages of bags of ROS 1 (``.bag``), one at a time."""

import weakref
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from bumpymap.core import UsageError
from bumpymap.readers.frames.bag import BagRecord
from bumpymap.readers.source import decoding

__all__ = ["Ros1Bag", "is_ros1"]


def is_ros1(path: Path) -> bool:
    """Return whether a path is a bag of ROS 1, by its suffix."""
    return path.suffix.lower() == ".bag" and not path.is_dir()


class Ros1Bag:
    """An open bag of ROS 1; it is closed when the object is collected.

    Parameters
    ----------
    path : Path

    Raises
    ------
    BadInputError
        The bag cannot be read.
    UsageError
        The extra ``ros`` is not installed.
    """

    def __init__(self, path: Path) -> None:
        try:
            from rosbags.rosbag1 import Reader
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise UsageError(
                f"bags are read with rosbags, which cannot be imported ({error}): pip install 'bumpymap[ros]'"
            ) from error
        self.path = path
        self._types = get_typestore(Stores.ROS1_NOETIC)
        with decoding(path, "the bag"):
            self._reader = Reader(path)
            self._reader.open()
            weakref.finalize(self, self._reader.close)
            self.topics = {
                topic: (str(info.msgtype), int(info.msgcount)) for topic, info in self._reader.topics.items()
            }
            """Type, as ROS 2 spells it, and number of messages of each topic."""

    def messages(self, topics: Collection[str]) -> Iterator[BagRecord]:
        """Yield the messages of some topics in order of time. Raises BadInputError if the bag is damaged."""
        wanted = [connection for connection in self._reader.connections if connection.topic in topics]
        with decoding(self.path, "the bag"):
            for connection, time_ns, data in self._reader.messages(wanted) if wanted else ():
                yield BagRecord(connection.topic, time_ns, bytes(data))

    def decode(self, data: bytes, kind: str) -> Any:
        """Deserialise a message. Raises BadInputError if it is damaged."""
        with decoding(self.path, "the bag"):
            return self._types.deserialize_ros1(data, kind)
