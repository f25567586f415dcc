"""Made-up bags of ROS 2: scans in any layout of fields, odometry and transforms, written with rosbags."""

from types import SimpleNamespace

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
CLOUD, ODOMETRY, TF = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
FIELD = "sensor_msgs/msg/PointField"
CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
LIDAR = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "ring", "time"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"],
        "offsets": [0, 4, 8, 16, 20, 24],
        "itemsize": 32,
    }
)
"""A common layout, with padding."""


def message(kind, store=STORE, **values):
    return store.types[kind](**values)


def header(stamp_ns, frame, store=STORE, **more):
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    stamp = message("builtin_interfaces/msg/Time", store, sec=sec, nanosec=nanosec)
    return message("std_msgs/msg/Header", store, stamp=stamp, frame_id=frame, **more)


def cloud(rows, stamp_ns=0, frame="lidar", row_step=None):
    """A PointCloud2 of a structured array, (n,) or (height, width); ``row_step`` adds padding to each row."""
    rows = np.atleast_2d(rows)
    height, width = rows.shape
    step = rows.dtype.itemsize
    pitch = row_step or width * step
    data = np.zeros((height, pitch), np.uint8)
    data[:, : width * step] = np.ascontiguousarray(rows).view(np.uint8).reshape(height, width * step)
    swapped = any(rows.dtype[name].str.startswith(">") for name in rows.dtype.names)
    placed = rows.dtype.fields
    fields = [
        message(FIELD, name=name, offset=placed[name][1], datatype=CODES[rows.dtype[name].str[1:]], count=1)
        for name in rows.dtype.names
    ]
    return message(
        CLOUD,
        header=header(stamp_ns, frame),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=swapped,
        point_step=step,
        row_step=pitch,
        data=data.ravel(),
        is_dense=False,
    )


def lidar_rows(points):
    rows = np.zeros(len(points), LIDAR)
    for axis, column in zip("xyz", np.asarray(points).T, strict=True):
        rows[axis] = column
    rows["intensity"] = np.arange(len(points)) % 200
    return rows


def vector(values, kind="geometry_msgs/msg/Vector3", store=STORE):
    x, y, z = map(float, values)
    return message(kind, store, x=x, y=y, z=z)


def _turn(rotation):
    x, y, z, w = rotation.as_quat()
    return message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def odometry(stamp_ns, pose, child="base"):
    """Of a pose: rotation of scipy and place."""
    rotation, place = pose
    nothing = vector(np.zeros(3))
    there = message(
        "geometry_msgs/msg/Pose", position=vector(place, "geometry_msgs/msg/Point"), orientation=_turn(rotation)
    )
    speed = message("geometry_msgs/msg/Twist", linear=nothing, angular=nothing)
    return message(
        ODOMETRY,
        header=header(stamp_ns, "odom"),
        child_frame_id=child,
        pose=message("geometry_msgs/msg/PoseWithCovariance", pose=there, covariance=np.zeros(36)),
        twist=message("geometry_msgs/msg/TwistWithCovariance", twist=speed, covariance=np.zeros(36)),
    )


def transforms(stamp_ns, *links):
    """A TFMessage of links: parent, child, (rotation, place)."""
    return message(
        TF,
        transforms=[
            message(
                "geometry_msgs/msg/TransformStamped",
                header=header(stamp_ns, parent),
                child_frame_id=child,
                transform=message("geometry_msgs/msg/Transform", translation=vector(place), rotation=_turn(rotation)),
            )
            for parent, child, (rotation, place) in links
        ],
    )


def imu(stamp_ns, rate, *, has_rate=True, turn=(0.0, 0.0, 0.0, 0.0), store=STORE, **more):
    """Of an IMU; ``more`` goes to its header."""
    x, y, z, w = map(float, turn)
    unknown = np.r_[-1.0, np.zeros(8)]
    return message(
        "sensor_msgs/msg/Imu",
        store,
        header=header(stamp_ns, "imu", store, **more),
        orientation=message("geometry_msgs/msg/Quaternion", store, x=x, y=y, z=z, w=w),
        orientation_covariance=np.zeros(9) if any(turn) else unknown,
        angular_velocity=vector(rate, store=store),
        angular_velocity_covariance=np.zeros(9) if has_rate else unknown,
        linear_acceleration=vector((0.1, 0.2, 9.8), store=store),
        linear_acceleration_covariance=np.zeros(9),
    )


def write_bag(folder, messages, storage="mcap", compression=None):
    """Write (topic, time_ns, message) to a new bag in a folder, in the given order; return the folder."""
    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    writer = Writer(folder, version=8, storage_plugin=plugin)
    if compression:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode

        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        topics = {}
        for topic, time_ns, each in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, each.__msgtype__, typestore=STORE)
            writer.write(topics[topic], time_ns, STORE.serialize_cdr(each, each.__msgtype__))
    return folder


def write_ros1(path, readings):
    """Write readings of an IMU, (stored_ns, stamp_ns, rate), to a bag of ROS 1; return the file."""
    from rosbags.rosbag1 import Writer as Ros1Writer

    store = get_typestore(Stores.ROS1_NOETIC)
    with Ros1Writer(path) as writer:
        topic = writer.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        for number, (stored_ns, stamp_ns, rate) in enumerate(readings):
            made = imu(stamp_ns, rate, turn=(0, 0, 0, 1), store=store, seq=number)
            writer.write(topic, stored_ns, store.serialize_ros1(made, made.__msgtype__))
    return path


def as_rclpy(each):
    """The same message with the types that rclpy gives: data as an ``array.array``."""
    import array

    values = {name: getattr(each, name) for name in each.__dataclass_fields__ if name != "__msgtype__"}
    return SimpleNamespace(**{**values, "data": array.array("B", each.data.tobytes())})
