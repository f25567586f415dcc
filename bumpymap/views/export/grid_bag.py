"""Write the grids of all frames to a bag of ROS 2 (``.mcap``): an OccupancyGrid and a GridMap for each frame.

The messages of a frame are written to a file of their own as soon as it is classified, so that a run can be resumed,
and are joined to the bag at the end, one frame at a time.
"""

import shutil
import struct
from collections.abc import Iterable
from os.path import lexists
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import NOT_TRAVERSABLE, Frame, GroundGrid, OutputError, atomic, remove_path
from bumpymap.views.export.gridmap import GRID_MAP, grid_map_message, make_header, require_rosbags, typestore

_OCCUPANCY = "nav_msgs/msg/OccupancyGrid"
GRID_TOPICS = {"/ground/occupancy": _OCCUPANCY, "/ground/grid_map": GRID_MAP}
"""Topics of the bag and their types."""
GRID_LAYERS = ("elevation", "step", "obstacle_height", "clearance")
"""Layers of the grid_map beside the class and the ride."""
_SENSOR = "sensor"
"""Coordinate frame of scans whose file names none."""
_PERIOD_NS = 100_000_000
"""Time between scans whose files hold no time."""


def check_bag_file(path: Path, out: Path, inputs: Iterable[Path], *, overwrite: bool) -> None:
    """Check that a bag can be written, before the long work.

    A bag that is a symbolic link will be replaced as a link; its target is not touched.

    Raises
    ------
    OutputError
        The file exists and ``overwrite`` is False, is a folder, is or lies in an input, would lie in a folder of
        ``out`` that is replaced, or its folder does not exist.
    UsageError
        The extra ``ros`` is not installed.
    """
    require_rosbags()
    if any(path.resolve() == own.resolve() or own.resolve() in path.resolve().parents for own in inputs):
        raise OutputError(f"{path} is an input of this run, or inside of one. Choose another `bag`")
    if out.resolve() in path.resolve().parent.parents:
        raise OutputError(f"{path} lies in a folder inside of {out}, which the run replaces. Choose another `bag`")
    if lexists(path) and (not overwrite or path.is_dir()):
        raise OutputError(f"{path} exists already. Choose another `bag`, or pass `overwrite=True` to replace it")
    if not path.parent.is_dir():
        raise OutputError(f"cannot write {path}: there is no folder {path.parent}. Choose another `bag`")


class GridBag:
    """The grids of a run while frame after frame is added, in any order; several threads may add frames.

    Parameters
    ----------
    folder : Path
        Folder of the run, for the messages of the frames.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._store = typestore()

    def part(self, number: int) -> Path:
        """Return the file with the messages of the frame with that number in the run."""
        return self._folder / f"grids-{number:06d}.cdr"

    def add(self, frame: Frame, number: int, grid: GroundGrid) -> None:
        """Write the grid of a frame to its file, without flushing it to the disk."""
        stamp_ns, frame_id = number * _PERIOD_NS, _SENSOR
        if frame.message is not None:
            stamp_ns, frame_id = frame.message.stamp_ns, frame.message.frame_id
        header = make_header(self._store, stamp_ns, frame_id)
        occupancy = grid.fill(self._blank(header), header)
        occupancy.data = np.frombuffer(occupancy.data, np.int8)
        class_id = np.where(grid.class_id == NOT_TRAVERSABLE, np.nan, grid.class_id).astype(np.float32)
        layers = {"class": class_id} | {name: getattr(grid, name) for name in GRID_LAYERS}
        if grid.c_r is not None:
            layers["c_r"] = grid.c_r
        layers = {name: layer[::-1] for name, layer in layers.items()}
        grid_map = grid_map_message(self._store, header, (0.0, 0.0), grid.resolution_m, layers)
        with self.part(number).open("wb") as file:
            file.write(struct.pack("<q", stamp_ns))
            for message, kind in zip((occupancy, grid_map), GRID_TOPICS.values(), strict=True):
                data = self._store.serialize_cdr(message, kind)
                file.write(struct.pack("<q", len(data)))
                file.write(data)

    def write(self, path: Path, numbers: Iterable[int]) -> None:
        """Join the grids of frames to a bag, which appears when it is complete.

        Parameters
        ----------
        path : Path
        numbers : iterable of int
            Of frames that were added, in order of time.

        Raises
        ------
        OutputError
            The bag cannot be written.
        """
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        bag = self._folder / "grids"
        if lexists(bag):
            remove_path(bag)
        writer = Writer(bag, version=8, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            topics = [writer.add_connection(topic, kind, typestore=self._store) for topic, kind in GRID_TOPICS.items()]
            for number in numbers:
                stamp, *messages = _messages(self.part(number).read_bytes())
                for topic, data in zip(topics, messages, strict=True):
                    writer.write(topic, stamp, data)
        with atomic(path) as temporary:
            shutil.move(bag / "grids.mcap", temporary)
        remove_path(bag)

    def _blank(self, header: Any) -> Any:
        """Return an OccupancyGrid with nothing in it."""
        types = self._store.types
        origin = types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](x=0.0, y=0.0, z=0.0),
            orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        )
        return types[_OCCUPANCY](
            header=header,
            info=types["nav_msgs/msg/MapMetaData"](
                map_load_time=header.stamp, resolution=0.0, width=0, height=0, origin=origin
            ),
            data=np.empty(0, np.int8),
        )


def _messages(data: bytes) -> Iterable[Any]:
    """Yield the time of a frame's file, and the messages in it."""
    yield struct.unpack_from("<q", data)[0]
    place = 8
    while place < len(data):
        (size,) = struct.unpack_from("<q", data, place)
        yield data[place + 8 : place + 8 + size]
        place += 8 + size
