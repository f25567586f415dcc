"""What columns of drives are called: patterns of names whose words are in lower case, joined by underscores.

Other words may stand before what a pattern describes (``imu_gyro_x``), unless it begins with ``=``. Patterns stand in
the order in which they are tried, the surest first.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bumpymap.readers.drives.quantities import (
    ACCELERATIONS,
    ANGLES,
    EASTING_NORTHING,
    LOCAL,
    LONLAT,
    QUATERNION,
    RATES,
    SIDES,
)

__all__ = ["GROUPS", "SINGLE", "UNIT_SUFFIX", "ColumnGroup"]


class ColumnGroup(NamedTuple):
    """Quantities that are found together or not at all."""

    quantities: tuple[str, ...]
    patterns: Sequence[str]
    places: Mapping[str, int]
    """What the pattern captures -> which of the quantities it is."""


_AXES = {"x": 0, "y": 1, "z": 2, "w": 3, "0": 0, "1": 1, "2": 2, "roll": 0, "pitch": 1, "yaw": 2}
_EAST = dict.fromkeys(("lon", "lng", "long", "longitude", "easting", "east", "e", "x"), 0)
_NORTH = dict.fromkeys(("lat", "latitude", "northing", "north", "n", "y"), 1)
_PLACES = {**_EAST, **_NORTH}
_LEFT_RIGHT = {"l": 0, "left": 0, "r": 1, "right": 1}

GROUPS = (
    ColumnGroup(
        RATES,
        (
            r"(?:angular_velocity|angular_rate|ang_vel|gyroscope|gyro|gyr|gyro_rad|omega|w)_?([xyz012])",
            r"(?:rotation_rate|turn_rate|rate|body_rate|angular)_?([xyz])",
            r"([xyz])_?(?:gyro|rate)",
            r"(roll|pitch|yaw)_?(?:rate|speed|vel|velocity)",
            r"=g_?([xyz])",
        ),
        _AXES,
    ),
    ColumnGroup(
        ACCELERATIONS,
        (
            r"(?:linear_acceleration|lin_acc|accelerometer|acceleration|accel|accelerometer_m_s2|acc|a)_?([xyz012])",
            r"specific_force_?([xyz])",
            r"([xyz])_?(?:acc|accel)",
        ),
        _AXES,
    ),
    ColumnGroup(QUATERNION, (r"(?:orientation|quaternion|quat|rotation|attitude|q)_?([xyzw])",), _AXES),
    ColumnGroup(ANGLES, (r"(roll|pitch|yaw)(?:_angle)?",), _AXES),
    ColumnGroup(LONLAT, (r"(lon|lng|long|longitude|lat|latitude)",), _PLACES),
    ColumnGroup(EASTING_NORTHING, (r"(easting|northing)", r"=(?:utm_|map_)?(east|north|e|n)", r"utm_?([xy])"), _PLACES),
    ColumnGroup(LOCAL, (r"(?:position|translation|pos|odom|odometry|pose|local)_?([xy])", r"=([xy])"), _AXES),
    ColumnGroup(
        SIDES,
        (
            r"(?:wheel_?speed|wheel_?vel|wheel_?velocity|wheel|speed|vel|velocity|v)_?(l|r|left|right)",
            r"(left|right|l|r)_?(?:wheel_?)?(?:speed|vel|velocity)",
        ),
        _LEFT_RIGHT,
    ),
)
SINGLE: Mapping[str, Sequence[str]] = {
    "time": (
        r"(?:header_)?stamp(?:_secs?)?",
        r"timestamp|time_stamp",
        r"=(?:time|t|ts)",
        r"=(?:date_?time|utc|time_utc|gpst|unix|epoch|seconds_elapsed|time_elapsed|elapsed|elapsed_time|secs?|seconds)",
        r"=date",
        r"time|time_boot",
    ),
    "date": (r"=(?:date|utc_date|day)",),
    "speed": (
        r"wheel_?(?:speed|velocity|vel)",
        r"=(?:.*twist_)?linear(?:_velocity)?_x",
        r"=(?:gps_?|gnss_?|vehicle_?|robot_?|ground_?|odom_?|base_?|g_?)?(?:speed|velocity|vel|v|spd)",
    ),
    "error": (
        r"h_?acc|horizontal_accuracy|hor_acc|h_accuracy|h_rms|eph|horizontal_error|position_error|pos_error|pos_sd",
        r"=(?:accuracy|sigma|error)",
        r"=(?:sdn|sd_n|sd_north|std_n)",
    ),
    "fix": (r"fix_type|fix|status_status|gps_qual", r"=(?:quality|status)"),
}
UNIT_SUFFIX = (
    r"_(s|secs?|ms|msec|millis|us|usec|micros|ns|nsec|nanos|dps|mdps|degs?|deg_s|deg_per_s|degps|rads?|rad_s|rad_per_s"
    r"|g|mg|m_s2|m_s_2|mps2|ms2|mps|m_s|kmh|kph|km_h|deg_?e7|e7|degrees|m|mm|cm)$"
)
"""A unit at the end of a name."""
