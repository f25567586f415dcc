"""Bags of ROS 2 (MCAP): a map as one grid_map message, and the grids of scans. No ROS is needed to write them."""

import shutil
from collections.abc import Iterable, Mapping
from os.path import lexists
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    NO_CLASS,
    NOT_TRAVERSABLE,
    Frame,
    GroundGrid,
    OutputError,
    UsageError,
    atomic,
    install_command,
    remove_path,
)
from bumpymap.layers import MapFile, require_new_file, require_written
from bumpymap.views.export.area import FRAME, FREE_CELL, LETHAL, ExportArea, by_pixel, cell_states
from bumpymap.views.page.tiles import block_means

TOPIC = "/grid_map"
GRID_MAP = "grid_map_msgs/msg/GridMap"
_MAX_CELLS = 5_000_000
"""Most cells: 100 MB in one message."""
_DEFINITIONS = {
    "grid_map_msgs/msg/GridMapInfo": """\
float64 resolution
float64 length_x
float64 length_y
geometry_msgs/Pose pose
""",
    GRID_MAP: """\
std_msgs/Header header
grid_map_msgs/GridMapInfo info
string[] layers
string[] basic_layers
std_msgs/Float32MultiArray[] data
uint16 outer_start_index
uint16 inner_start_index
""",
}
"""Fields of the messages, in the order of ROS 2."""


def require_rosbags() -> None:
    """Raise UsageError if the extra ``ros`` is not installed."""
    try:
        import rosbags.rosbag2
        import rosbags.typesys  # noqa: F401 (tried)
    except ImportError as error:
        raise UsageError(
            f"a bag is written with rosbags, which cannot be imported ({error}): {install_command('ros')}"
        ) from error


def _read_layers(area: ExportArea) -> dict[str, NDArray[np.float32]]:
    """Read the layers of an area by name, (rows, cols) each, north row first; NaN where unknown.

    Obstacle is 0 where a cell is free, 1 where it is not passable, 2 where it is free under canopy. With one cell a
    tile, elevation is the mean of the tile's heights. Raises BadInputError: there are too many cells, or class.tif is
    missing or damaged.
    """
    area.require_cells(_MAX_CELLS, "a grid_map")
    site = area.route_map
    require_written(site.folder, site.manifest, (MapFile.CLASS,))  # `open_map` does not look at it
    layers = {name: np.empty(area.shape, np.float32) for name in ("elevation", "c_r", "p_fail", "class", "obstacle")}
    for window, lines in area.strips():
        values = site.values(window, ("c_r", "p_fail"), classes=True)
        layers["class"][lines] = by_pixel(values["class_id"], area.split)
        for name in ("c_r", "p_fail"):
            layers[name][lines] = by_pixel(values[name], area.split)
        heights = site.heights(window)
        layers["elevation"][lines] = block_means(heights, (window.rows, window.cols)) if area.split == 1 else heights
        states, canopy = cell_states(area, site.read(window, ("c_r", "p_fail", "obstacle")))
        state = np.select([canopy, states == LETHAL, states == FREE_CELL], [2.0, 1.0, 0.0], np.nan)
        layers["obstacle"][lines] = state
    layers["class"][layers["class"] == NO_CLASS] = np.nan
    return layers


def typestore() -> Any:
    """Return the message types of ROS 2 with those of grid_map."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def write_gridmap(folder: Path, area: ExportArea) -> dict[str, Any]:
    """Write gridmap.mcap and metadata.yaml, which make the folder a bag; return what the sidecar file says of it.

    All times are 0, so that the same map has the same bytes. Late subscribers get the message too. Version 8 of the
    metadata is the newest that all current releases of ROS 2 read. Raises UsageError: the extra ``ros`` is not
    installed; BadInputError: there are too many cells, or class.tif is missing or damaged.
    """
    require_rosbags()
    from rosbags.rosbag2 import StoragePlugin, Writer

    store, bag, bounds, layers = typestore(), folder / "gridmap", area.bounds, _read_layers(area)
    middle = ((bounds.west + bounds.east) / 2.0, (bounds.south + bounds.north) / 2.0)
    message = grid_map_message(store, make_header(store, 0, FRAME), middle, area.resolution, layers)
    with Writer(bag, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection(TOPIC, GRID_MAP, typestore=store, offered_qos_profiles=[_latched()])
        writer.write(topic, 0, store.serialize_cdr(message, GRID_MAP))
    for path in [*bag.iterdir()]:
        path.rename(folder / path.name)
    bag.rmdir()
    return {"topic": TOPIC, "type": GRID_MAP, "layer_names": list(layers)}


def _latched() -> Any:
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(0, 0)
    return Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        avoid_ros_namespace_conventions=False,
    )


def make_header(store: Any, stamp_ns: int, frame_id: str) -> Any:
    """Make a ``std_msgs/Header`` of a time [ns] and a coordinate frame; ``store`` is from `typestore`."""
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    stamp = store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def grid_map_message(
    store: Any, header: Any, middle: tuple[float, float], resolution: float, layers: Mapping[str, NDArray[np.float32]]
) -> Any:
    """Make a message ``grid_map_msgs/GridMap``.

    ``store``: from `typestore`; ``middle``: x and y of the middle of the grid in the frame of the header, m;
    ``resolution``: side of a cell, m; ``layers``: one of them is ``elevation``.
    """
    types = store.types
    rows, cols = layers["elevation"].shape
    info = types["grid_map_msgs/msg/GridMapInfo"](
        resolution=resolution,
        length_x=cols * resolution,
        length_y=rows * resolution,
        pose=_upright_pose(types, *middle),
    )
    return types[GRID_MAP](
        header=header,
        info=info,
        layers=list(layers),
        basic_layers=["elevation"],
        data=[_array(types, layer) for layer in layers.values()],
        outer_start_index=0,
        inner_start_index=0,
    )


def _upright_pose(types: Any, x: float, y: float) -> Any:
    return types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
    )


def _array(types: Any, layer: NDArray[np.float32]) -> Any:
    """Pack a layer: rows of the matrix run from east to west, its columns from north to south, columns one by one."""
    rows, cols = layer.shape
    dimension = types["std_msgs/msg/MultiArrayDimension"]
    outer = dimension(label="column_index", size=rows, stride=rows * cols)
    inner = dimension(label="row_index", size=cols, stride=cols)
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[outer, inner], data_offset=0)
    return types["std_msgs/msg/Float32MultiArray"](layout=layout, data=layer[:, ::-1].ravel())


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

    A bag that is a symbolic link will be replaced as a link; its target is not touched. Raises OutputError: the file
    exists and ``overwrite`` is False, is a folder, is or lies in an input, would lie in a folder of ``out`` that is
    replaced, or its folder does not exist; UsageError: the extra ``ros`` is not installed.
    """
    require_rosbags()
    if any(path.resolve() == own.resolve() or own.resolve() in path.resolve().parents for own in inputs):
        raise OutputError(f"{path} is an input of this run, or inside of one. Choose another `bag`")
    if out.resolve() in path.resolve().parent.parents:
        raise OutputError(f"{path} lies in a folder inside of {out}, which the run replaces. Choose another `bag`")
    require_new_file(path, overwrite=overwrite and not path.is_dir(), option="bag")


def write_grid_bag(path: Path, folder: Path, grids: Iterable[tuple[Frame, int, GroundGrid]]) -> None:
    """Write grids to a bag, which appears when it is complete.

    ``folder``: folder of the run, for the bag until then; ``grids``: frames, their numbers in the run, their grids, in
    order of time. Raises OutputError: the bag cannot be written.
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
    info = store.types["nav_msgs/msg/MapMetaData"](
        map_load_time=header.stamp, resolution=0.0, width=0, height=0, origin=_upright_pose(store.types, 0.0, 0.0)
    )
    blank = store.types[_OCCUPANCY](header=header, info=info, data=np.empty(0, np.int8))
    occupancy = grid.fill(blank, header)
    occupancy.data = np.frombuffer(occupancy.data, np.int8)
    class_id = np.where(grid.class_id == NOT_TRAVERSABLE, np.nan, grid.class_id).astype(np.float32)
    layers = {"class": class_id} | {name: getattr(grid, name) for name in GRID_LAYERS}
    if grid.c_r is not None:
        layers["c_r"] = grid.c_r
    layers = {name: layer[::-1] for name, layer in layers.items()}
    return stamp_ns, (occupancy, grid_map_message(store, header, middle, grid.resolution_m, layers))
