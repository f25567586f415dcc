"""Write the grids of frames to a bag of ROS 2 (``.mcap``): an OccupancyGrid and a GridMap for each."""

import shutil
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


def write_grid_bag(path: Path, folder: Path, grids: Iterable[tuple[Frame, int, GroundGrid]]) -> None:
    """Write grids to a bag, which appears when it is complete.

    Parameters
    ----------
    path : Path
    folder : Path
        Folder of the run, for the bag until then.
    grids : iterable of Frame, int and GroundGrid
        Frames, their numbers in the run, their grids, in order of time.

    Raises
    ------
    OutputError
        The bag cannot be written.
    """
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    store, bag = typestore(), folder / "grids"
    if lexists(bag):
        remove_path(bag)
    writer = Writer(bag, version=8, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        topics = [writer.add_connection(topic, kind, typestore=store) for topic, kind in GRID_TOPICS.items()]
        for frame, number, grid in grids:
            stamp_ns, messages = _messages_of(store, frame, number, grid)
            for topic, message, kind in zip(topics, messages, GRID_TOPICS.values(), strict=True):
                writer.write(topic, stamp_ns, store.serialize_cdr(message, kind))
    with atomic(path) as temporary:
        shutil.move(bag / "grids.mcap", temporary)
    remove_path(bag)


def _messages_of(store: Any, frame: Frame, number: int, grid: GroundGrid) -> tuple[int, tuple[Any, Any]]:
    """Return the time of a frame, ns, and its OccupancyGrid and GridMap."""
    stamp_ns, frame_id = number * _PERIOD_NS, _SENSOR
    if frame.message is not None:
        stamp_ns, frame_id = frame.message.stamp_ns, frame.message.frame_id
    middle = (0.0, 0.0)
    if grid.corner_m is not None:
        frame_id, middle = frame.pose_frame, (grid.corner_m[0] + grid.reach_m, grid.corner_m[1] + grid.reach_m)
    header = make_header(store, stamp_ns, frame_id)
    occupancy = grid.fill(_blank(store, header), header)
    occupancy.data = np.frombuffer(occupancy.data, np.int8)
    class_id = np.where(grid.class_id == NOT_TRAVERSABLE, np.nan, grid.class_id).astype(np.float32)
    layers = {"class": class_id} | {name: getattr(grid, name) for name in GRID_LAYERS}
    if grid.c_r is not None:
        layers["c_r"] = grid.c_r
    layers = {name: layer[::-1] for name, layer in layers.items()}
    return stamp_ns, (occupancy, grid_map_message(store, header, middle, grid.resolution_m, layers))


def _blank(store: Any, header: Any) -> Any:
    """Return an OccupancyGrid with nothing in it."""
    types = store.types
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
