"""Points of a message ``sensor_msgs/PointCloud2``, whatever the layout of its fields.

The functions take the message of any library: rclpy gives the data as ``array.array``, rosbags as an array of numpy.
They look only at its attributes and need neither library.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, UsageError, short_repr
from bumpymap.readers.frames.point_time import TIME_COLUMNS, point_seconds, start_of_day_time
from bumpymap.readers.frames.raw import RawScan

__all__ = ["points_of", "read_cloud"]

_ATTRIBUTES = ("height", "width", "point_step", "row_step", "is_bigendian", "fields", "data")
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Types of numpy of the constants in sensor_msgs/PointField."""
_INTENSITY = ("intensity", "intensities", "reflectivity")
"""Names of fields with the strength of the return; the first one that is there is taken."""
_SAME_CLOCK_S = 2.0
"""Times of points and of the header that are farther apart are of different clocks: no scan takes longer."""


def points_of(message: Any) -> NDArray[np.float32]:
    """Return the points of a message.

    Parameters
    ----------
    message : sensor_msgs/PointCloud2
        From rclpy, rosbags or any other library with the same names of attributes.

    Returns
    -------
    (n, 3) float32
        x, y and z of all returns, m, also of those that are NaN; of an organised cloud row by row.

    Raises
    ------
    BadInputError
        The message has no x, y and z, or less data than it declares.
    UsageError
        This is no such message.
    """
    missing = [name for name in _ATTRIBUTES if not hasattr(message, name)]
    if missing:
        raise UsageError(
            f"message is {short_repr(message)}, without {', '.join(missing)}; give a message sensor_msgs/PointCloud2"
        )
    return _xyz(_rows(message))


def read_cloud(message: Any) -> RawScan:
    """Read all returns of a message: points and, if there are fields for them, intensity and time.

    Times of day count from the time in the header, if they are near to it, else from the first.

    Raises
    ------
    BadInputError
        See `points_of`.
    """
    rows = _rows(message)
    intensity, time = (_column(rows, names) for names in (_INTENSITY, TIME_COLUMNS))
    seconds = None if time is None else point_seconds(time)
    if time is not None and seconds is not None:
        start, stamp = start_of_day_time(time), message.header.stamp
        late = 0.0 if start is None else start - (stamp.sec + 1e-9 * stamp.nanosec)
        seconds += np.float32(late if abs(late) < _SAME_CLOCK_S else 0.0)
    return RawScan(_xyz(rows), None if intensity is None else intensity.astype(np.float32), None, seconds)


def _column(rows: NDArray[np.void], names: tuple[str, ...]) -> NDArray[Any] | None:
    """Return the values of the first of some fields that is there, (n,)."""
    name = next((name for name in names if name in (rows.dtype.names or ())), None)
    return None if name is None else rows[name].ravel()


def _xyz(rows: NDArray[np.void]) -> NDArray[np.float32]:
    points = np.empty((*rows.shape, 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is dropped and counted later
        for column, axis in enumerate("xyz"):
            points[..., column] = rows[axis]
    return points.reshape(-1, 3)


def _rows(message: Any) -> NDArray[np.void]:
    """Return a view of the points, (height, width), with the fields that hold one number each."""
    height, width, step = int(message.height), int(message.width), int(message.point_step)
    dtype = _dtype(message, step)
    data = np.frombuffer(message.data, np.uint8)
    pitch = int(message.row_step) if height > 1 else width * step
    needed = (height - 1) * pitch + width * step if height and width else 0
    if pitch < width * step or needed > data.size:
        raise BadInputError(
            f"the point cloud declares {height:,} x {width:,} points of {step} bytes, in rows of {message.row_step:,} "
            f"bytes, and holds {data.size:,} bytes of data. The message is damaged or its driver is faulty"
        )
    return np.ndarray((height, width) if needed else (0, 0), dtype, data, strides=(pitch, step))


def _dtype(message: Any, step: int) -> np.dtype[np.void]:
    order = ">" if message.is_bigendian else "<"
    fields = {
        str(field.name): (np.dtype(order + _TYPES[int(field.datatype)]), int(field.offset))
        for field in message.fields
        if int(field.datatype) in _TYPES and int(field.count) <= 1
    }
    missing = [axis for axis in "xyz" if axis not in fields]
    outside = [name for name, (kind, offset) in fields.items() if offset + kind.itemsize > step]
    if missing or outside:
        names = ", ".join(str(field.name) for field in message.fields) or "none"
        what = (
            f"has no {', '.join(missing)}" if missing else f"declares {outside[0]} outside of its {step} bytes a point"
        )
        raise BadInputError(f"the point cloud {what}; its fields are {names}. x, y and z are needed, a number each")
    return np.dtype(
        {
            "names": list(fields),
            "formats": [kind for kind, _ in fields.values()],
            "offsets": [offset for _, offset in fields.values()],
            "itemsize": step,
        }
    )
