"""Which quantities the names of columns tell, in headers as loggers write them."""

import pytest

from bumpymap.readers.drives.quantities import guess_columns

RATES = ("rate_x", "rate_y", "rate_z")
HEADERS = {
    "arduino": ("millis,ax,ay,az,gx,gy,gz,temp", {"time": "millis", "rate_y": "gy", "acc_z": "az"}),
    "phyphox": (
        "Time (s),Gyroscope x (rad/s),Gyroscope y (rad/s),Gyroscope z (rad/s),Absolute (rad/s)",
        {"time": "Time (s)", "rate_z": "Gyroscope z (rad/s)"},
    ),
    "flat odometry": (
        (
            "Time,header.stamp.secs,header.stamp.nsecs,header.frame_id,pose.pose.position.x,pose.pose.position.y,"
            "pose.pose.position.z,pose.pose.orientation.x,pose.pose.orientation.y,pose.pose.orientation.z,"
            "pose.pose.orientation.w,twist.twist.linear.x,twist.twist.linear.y,twist.twist.angular.x,"
            "twist.twist.angular.y,twist.twist.angular.z"
        ),
        {
            "time": "header.stamp.secs",
            "nanosec": "header.stamp.nsecs",
            "x": "pose.pose.position.x",
            "q_w": "pose.pose.orientation.w",
            "speed": "twist.twist.linear.x",
            "rate_y": "twist.twist.angular.y",
        },
    ),
    "receiver": (
        "utc,lat_deg,lon_deg,height_m,fix_type,hAcc [mm],vel_n,vel_e,gSpeed",
        {"time": "utc", "latitude": "lat_deg", "fix": "fix_type", "error": "hAcc [mm]", "speed": "gSpeed"},
    ),
    "survey": ("t;E;N;H;sdn;sde", {"time": "t", "easting": "E", "northing": "N", "error": "sdn"}),
    "units in names": (
        "timestamp_us,gyro_x_mdps,gyro_y_mdps,gyro_z_mdps,acc_x_mg,acc_y_mg,acc_z_mg",
        {"time": "timestamp_us", "rate_x": "gyro_x_mdps", "acc_y": "acc_y_mg"},
    ),
    "wheels": ("time,curL,curR,velL,velR", {"time": "time", "speed_left": "velL", "speed_right": "velR"}),
    "quoted": ("ts,GPS Latitude,GPS Longitude,Roll Rate,Pitch Rate,Yaw Rate", {"time": "ts", "rate_y": "Pitch Rate"}),
}


@pytest.mark.parametrize("logger", HEADERS)
def test_headers_of_loggers(logger):
    text, expected = HEADERS[logger]
    found = guess_columns("a.csv", text.replace(";", ",").split(","))
    assert {quantity: found[quantity].name for quantity in expected} == expected


def test_units_in_names():
    text = HEADERS["units in names"][0] + ",hAcc [mm],speed_kmh,lat_e7,lon_e7,roll_deg,pitch_deg"
    found = guess_columns("a.csv", text.split(","))
    units = {"time": "us", "rate_x": "mdeg/s", "acc_y": "mg", "error": "mm", "speed": "km/h", "latitude": "dege7"}
    assert {quantity: found[quantity].unit for quantity in units} == units
    assert found["roll"].unit == "deg"


@pytest.mark.parametrize(
    ("text", "quantities"),
    [
        ("magnetic_field_x,magnetic_field_y,magnetic_field_z", set()),
        ("gyro_x,gyro_y", set()),  # not a whole group
        ("angular_velocity_covariance[0],angular_velocity_covariance[1],angular_velocity_covariance[2]", set()),
        ("time,gyro_t,sample_rate,max_x,min_y", {"time"}),
        ("velocity_x,velocity_y,velocity_z,wind_speed", set()),
        ("angular_velocity.x,angular_velocity.y,angular_velocity.z", set(RATES)),
        ("stamp_nsec", {"time"}),
    ],
)
def test_nothing_is_told_that_names_do_not_say(text, quantities):
    assert set(guess_columns("a.csv", text.split(","))) == quantities
