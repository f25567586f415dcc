"""What ``ros2 topic echo --csv`` writes: rows without a header line, whose columns follow from their number."""

from collections.abc import Sequence

__all__ = ["echo_names"]

_STAMP = ("header.stamp.sec", "header.stamp.nanosec", "header.frame_id")
_POINT = tuple(f"pose.position.{axis}" for axis in "xyz")
_TURN = tuple(f"orientation.{axis}" for axis in "xyzw")


def _covariance(name: str, count: int) -> tuple[str, ...]:
    return tuple(f"{name}_covariance_{place}" for place in range(count))


def _vector(name: str) -> tuple[str, ...]:
    return tuple(f"{name}.{axis}" for axis in "xyz")


_IMU = (
    *_STAMP,
    *_TURN,
    *_covariance("orientation", 9),
    *_vector("angular_velocity"),
    *_covariance("angular_velocity", 9),
    *_vector("linear_acceleration"),
    *_covariance("linear_acceleration", 9),
)
_FIX = (
    *_STAMP,
    *("status.status", "status.service", "latitude", "longitude", "altitude"),
    *_covariance("position", 9),
    "position_covariance_type",
)
_ODOMETRY = (
    *_STAMP,
    "child_frame_id",
    *_POINT,
    *_TURN,
    *_covariance("pose", 36),
    *_vector("twist.linear"),
    *_vector("twist.angular"),
    *_covariance("twist", 36),
)
_POSE = (*_STAMP, *_POINT, *_TURN)
_TWIST = (*_STAMP, *_vector("twist.linear"), *_vector("twist.angular"))
_BY_WIDTH = {len(names): names for names in (_IMU, _FIX, _ODOMETRY, _POSE, _TWIST)}


def echo_names(row: Sequence[str]) -> tuple[str, ...] | None:
    """Return the columns of a row of Imu, NavSatFix, Odometry, PoseStamped or TwistStamped; None if it is none.

    Their third value is the name of a coordinate frame, and the first two are whole numbers.
    """
    is_stamp = len(row) > 3 and row[0].isdigit() and row[1].isdigit() and any(map(str.isalpha, row[2]))
    return _BY_WIDTH.get(len(row)) if is_stamp else None
