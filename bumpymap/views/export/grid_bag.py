"""Write the grids of all frames to a bag of ROS 2 (``.mcap``): an OccupancyGrid and a GridMap for each frame.

The messages of a frame are written to a file of their own as soon as it is classified, so that a run can be resumed,
and are joined to the bag at the end, one frame at a time.
"""

import math
import shutil
import struct
from array import array
from collections.abc import Iterable
from os.path import lexists
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    NOT_TRAVERSABLE,
    ClassedSectors,
    Frame,
    GridSettings,
    OutputError,
    PolarCells,
    Scan,
    SectorStack,
    atomic,
    cell_numbers,
    remove_path,
)
from bumpymap.views.export.gridmap import GRID_MAP, grid_map_message, make_header, require_rosbags, typestore

__all__ = ["GridBag", "GroundGrid", "check_bag_file", "sector_occupancy"]

OCCUPANCY = (0, 33, 66, 100)
"""Occupancy of sectors of class 0 (smooth), 1 (fair) and 2 (rough), and of those that must not be entered."""
UNKNOWN_OCCUPANCY = -1
GRID_LAYERS = ("class", "elevation", "obstacle_height", "ground")

Message = TypeVar("Message")


class GroundGrid:
    """Makes grids of classified scans: x forward, y to the left, the sensor in the middle.

    Parameters
    ----------
    resolution_m : float
        Side of a cell.
    reach_m : float
        Distance from the sensor to each side of the grid.

    Raises
    ------
    UsageError
        The grid has no cells, or too many.
    """

    def __init__(self, resolution_m: float = 0.25, reach_m: float = 30.0) -> None:
        settings = GridSettings(resolution_m, reach_m)
        half = math.ceil(settings.reach_m / settings.resolution_m - 1e-9)
        self.resolution_m = settings.resolution_m
        self.side = 2 * half
        """Cells along each side."""
        centre = (np.arange(self.side) + 0.5) * self.resolution_m - self.reach_m
        x, y = np.tile(centre, self.side), np.repeat(centre, self.side)
        self._distance, self._turn = np.hypot(x, y), np.arctan2(y, x) / (2.0 * math.pi)
        self._places: PolarCells | None = None

    @property
    def reach_m(self) -> float:
        """Distance from the sensor to each side: whole cells."""
        return 0.5 * self.side * self.resolution_m

    def rows(self, stack: SectorStack) -> NDArray[np.int32]:
        """Return the row of the sector that holds the centre of each cell.

        Returns
        -------
        (side, side) int32
            From the lowest y upwards, and in each row from the lowest x; -1 where no measured sector is.
        """
        table = np.full(int(np.dot(stack.settings.sectors, stack.settings.rings)) + 1, -1, np.int32)
        table[cell_numbers(stack)] = np.arange(len(stack.zone))
        found: NDArray[np.int32] = table[self._placed(stack).cells(stack.azimuth_start_rad)]
        return found.reshape(self.side, self.side)

    def occupancy(self, classed: ClassedSectors) -> NDArray[np.int8]:
        """Return the occupancy of the cells, (side, side) int8, ordered as by `rows`.

        That of the sector, see `sector_occupancy`; unknown where no sector is measured, and beyond the end of the
        ground.
        """
        values = np.append(sector_occupancy(classed), np.int8(UNKNOWN_OCCUPANCY))
        cells: NDArray[np.int8] = values[self.rows(classed.sectors)]
        beyond = self._beyond_ground(classed.sectors) & (cells != OCCUPANCY[-1])
        return np.where(beyond, np.int8(UNKNOWN_OCCUPANCY), cells)

    def _beyond_ground(self, stack: SectorStack) -> NDArray[np.bool_]:
        """Return which cells (side, side) lie farther away than any ground in their direction."""
        count, share = len(stack.ground_end), self._placed(stack).share(stack.azimuth_start_rad)
        direction = np.minimum(share * count, count - 1.0).astype(np.int32)
        beyond: NDArray[np.bool_] = self._distance > stack.ground_end[direction] + 0.5 * self.resolution_m
        return beyond.reshape(self.side, self.side)

    def fill(self, message: Message, classed: ClassedSectors, header: Any) -> Message:
        """Fill a message ``nav_msgs/OccupancyGrid`` and return it.

        Parameters
        ----------
        message : nav_msgs/OccupancyGrid
            Of any library with the same names of attributes. Its data become an ``array.array``, which rclpy takes
            without looking at every cell.
        classed : ClassedSectors
        header : std_msgs/Header
            Of the point cloud: the grid lies in the sensor's frame at its time.
        """
        grid: Any = message
        grid.header = header
        grid.info.map_load_time = header.stamp
        grid.info.resolution = self.resolution_m
        grid.info.width = grid.info.height = self.side
        grid.info.origin.position.x = grid.info.origin.position.y = -self.reach_m
        grid.info.origin.orientation.w = 1.0
        grid.data = array("b", self.occupancy(classed).tobytes())
        return message

    def layers(self, scan: Scan, classed: ClassedSectors) -> dict[str, NDArray[np.float32]]:
        """Return layers for a grid_map, (side, side) float32 each, ordered as by `rows`.

        Returns
        -------
        dict
            ``class`` (0 to 2), ``obstacle_height`` (m) and ``ground`` (share of the points that are ground) of the
            sector; ``elevation``: mean z of the ground points in the cell, m, in the sensor's frame; if a vehicle was
            named, ``c_r`` (rad/m) of the sector. NaN where unknown.
        """
        stack, rows = classed.sectors, self.rows(classed.sectors)
        class_id = np.where(classed.class_id == NOT_TRAVERSABLE, np.nan, classed.class_id)
        share = stack.ground_count / np.maximum(stack.count, 1)
        by_sector = {"class": class_id, "obstacle_height": stack.obstacle_height, "ground": share}
        if classed.ride is not None:
            by_sector["c_r"] = classed.ride.c_r
        found = {name: np.append(values, np.nan).astype(np.float32)[rows] for name, values in by_sector.items()}
        found["class"][self._beyond_ground(stack)] = np.nan
        found["elevation"] = self._elevation(scan.points[stack.point_ground])
        return {name: found[name] for name in (*GRID_LAYERS, "c_r") if name in found}

    def _elevation(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        column, row = np.floor((points[:, :2].T.astype(np.float64) + self.reach_m) / self.resolution_m)
        inside = (column >= 0) & (column < self.side) & (row >= 0) & (row < self.side)
        cell = (row[inside] * self.side + column[inside]).astype(np.int64)
        count = np.bincount(cell, minlength=self.side**2)
        total = np.bincount(cell, points[inside, 2], self.side**2)
        mean = np.divide(total, count, out=np.full(self.side**2, np.nan), where=count > 0)
        heights: NDArray[np.float32] = mean.astype(np.float32).reshape(self.side, self.side)
        return heights

    def _placed(self, stack: SectorStack) -> PolarCells:
        places = self._places
        if places is None or places.settings != stack.settings:
            places = self._places = PolarCells.of(stack.settings, self._distance, self._turn)
        return places


def sector_occupancy(classed: ClassedSectors) -> NDArray[np.int8]:
    """Return the occupancy of the sectors of a scan.

    Returns
    -------
    (n,) int8
        0, 33, 66 for class 0, 1, 2; 100 where an obstacle stands, the ground drops, or the sector is not traversable.
    """
    values = np.array(OCCUPANCY, np.int8)[np.minimum(classed.class_id, len(OCCUPANCY) - 1)]
    return np.where(classed.sectors.obstacle, np.int8(OCCUPANCY[-1]), values)


_OCCUPANCY = "nav_msgs/msg/OccupancyGrid"
GRID_TOPICS = {"/ground/occupancy": _OCCUPANCY, "/ground/grid_map": GRID_MAP}
"""Topics of the bag and their types."""
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
    settings : GridSettings
    """

    def __init__(self, folder: Path, settings: GridSettings) -> None:
        self._folder = folder
        self._grid = GroundGrid(settings.resolution_m, settings.reach_m)
        self._store = typestore()

    def part(self, number: int) -> Path:
        """Return the file with the messages of the frame with that number in the run."""
        return self._folder / f"grids-{number:06d}.cdr"

    def add(self, frame: Frame, number: int, scan: Scan, classed: ClassedSectors) -> None:
        """Write the grids of a frame to its file, without flushing it to the disk."""
        grid, stamp_ns, frame_id = self._grid, number * _PERIOD_NS, _SENSOR
        if frame.message is not None:
            stamp_ns, frame_id = frame.message.stamp_ns, frame.message.frame_id
        header = make_header(self._store, stamp_ns, frame_id)
        occupancy = grid.fill(self._blank(header), classed, header)
        occupancy.data = np.frombuffer(occupancy.data, np.int8)
        layers = {name: layer[::-1] for name, layer in grid.layers(scan, classed).items()}
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
