"""A grid_map message in a ROS 2 bag (MCAP): elevation, c_r, p_fail, class, obstacle. No ROS is needed to write it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CANOPY, NO_CLASS, OutputError, UsageError, atomic, remove_path, write_remedy
from bumpymap.layers import MapFile, require_written
from bumpymap.views.export.area import FRAME, ExportArea, by_pixel
from bumpymap.views.page.tiles import block_means
from bumpytiles import TileWindow

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
            f"a bag is written with rosbags, which cannot be imported ({error}): pip install 'bumpymap[ros]'"
        ) from error


def make_layers(area: ExportArea) -> dict[str, NDArray[np.float32]]:
    """Read the layers of an area by name, (rows, cols) each, north row first; NaN where unknown.

    With one cell a tile, elevation is the mean of the tile's heights and obstacle the share of its pixels; else
    elevation is the heightmap and obstacle the state of the pixel: 0 free, 1 obstacle, 2 canopy, NaN unknown.

    Raises
    ------
    BadInputError
        There are too many cells, or class.tif is missing or damaged.
    """
    area.require_cells(_MAX_CELLS, "a grid_map")
    site = area.route_map
    require_written(site.folder, site.manifest, (MapFile.CLASS,))  # `open_map` does not look at it
    values = {name: np.empty(area.shape, np.float32) for name in ("elevation", "c_r", "p_fail", "class", "obstacle")}
    for window, lines in area.strips(detail=site.grid.pixels):
        for name, layer in _read(area, window).items():
            values[name][lines] = layer
    return values


def _read(area: ExportArea, window: TileWindow) -> dict[str, NDArray[np.float32]]:
    values = area.route_map.values(window, ("c_r", "p_fail", "obstacle"), classes=True)
    heights = area.route_map.heights(window)
    classes = np.where(values["class_id"] == NO_CLASS, np.nan, values["class_id"]).astype(np.float32)
    layers = {"c_r": values["c_r"], "p_fail": values["p_fail"], "class": classes}
    if area.split == 1:
        means = block_means(heights, (window.rows, window.cols))
        return layers | {"elevation": means, "obstacle": values["obstacle"]}
    objects = area.route_map.objects(window)
    state = np.where(objects > CANOPY, np.nan, objects).astype(np.float32)
    fine = {name: by_pixel(layer, area.split) for name, layer in layers.items()}
    return fine | {"elevation": heights, "obstacle": state}


def typestore() -> Any:
    """Return the message types of ROS 2 with those of grid_map."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def write_gridmap(folder: Path, area: ExportArea, layers: Mapping[str, NDArray[np.float32]]) -> dict[str, Any]:
    """Write gridmap.mcap and metadata.yaml, which make the folder a bag; return what the sidecar file says of it.

    All times are 0, so that the same map has the same bytes. Late subscribers get the message too. Version 8 of the
    metadata is the newest that all current releases of ROS 2 read.

    Raises
    ------
    OutputError
        The bag cannot be written.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    store, bag, bounds = typestore(), folder / "gridmap", area.bounds
    middle = ((bounds.west + bounds.east) / 2.0, (bounds.south + bounds.north) / 2.0)
    message = grid_map_message(store, make_header(store, 0, FRAME), middle, area.resolution, layers)
    try:
        with Writer(bag, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            topic = writer.add_connection(TOPIC, GRID_MAP, typestore=store, offered_qos_profiles=[_latched()])
            writer.write(topic, 0, store.serialize_cdr(message, GRID_MAP))
        for name in ("gridmap.mcap", "metadata.yaml"):
            with atomic(folder / name) as temporary:
                (bag / name).rename(temporary)
        remove_path(bag)
    except OSError as error:
        raise OutputError(
            f"cannot write the bag to {folder.parent}: {error}. {write_remedy(error, 'Choose another `out`')}"
        ) from error
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

    Parameters
    ----------
    store
        From `typestore`.
    header : std_msgs/Header
    middle : tuple of float
        x and y of the middle of the grid in the frame of the header, m.
    resolution : float
        Side of a cell, m.
    layers : mapping
        One of them is ``elevation``.
    """
    types = store.types
    rows, cols = layers["elevation"].shape
    point = types["geometry_msgs/msg/Point"](x=middle[0], y=middle[1], z=0.0)
    upright = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    info = types["grid_map_msgs/msg/GridMapInfo"](
        resolution=resolution,
        length_x=cols * resolution,
        length_y=rows * resolution,
        pose=types["geometry_msgs/msg/Pose"](position=point, orientation=upright),
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


def _array(types: Any, layer: NDArray[np.float32]) -> Any:
    """Pack a layer: rows of the matrix run from east to west, its columns from north to south, columns one by one."""
    rows, cols = layer.shape
    dimension = types["std_msgs/msg/MultiArrayDimension"]
    outer = dimension(label="column_index", size=rows, stride=rows * cols)
    inner = dimension(label="row_index", size=cols, stride=cols)
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[outer, inner], data_offset=0)
    return types["std_msgs/msg/Float32MultiArray"](layout=layout, data=layer[:, ::-1].ravel())
