"""Drives from CSV: what is told from names and values, what can be named, what is refused."""

import numpy as np
import pytest
from drive_tables import GRAVITY, NAMES, drive, gyro, refusal, renamed, write

from bumpymap.core import UsageError
from bumpymap.readers import parse_columns, read_drive


@pytest.mark.parametrize(
    ("separator", "before", "end"),
    [
        (",", "", "\n"),
        (";", "", "\n"),
        ("\t", "", "\r\n"),
        (" ", "# made by a logger\n", "\n"),
        (",", "\ufeff", "\r\n"),
    ],
)
def test_any_separator_remark_and_line_end_gives_the_same_drive(tmp_path, separator, before, end):
    columns = drive()
    log = read_drive(write(tmp_path / "drive.csv", columns, separator, before, end))
    np.testing.assert_array_equal(log.imu.time, columns["time"])
    np.testing.assert_array_equal(log.imu.rate, gyro(columns))
    np.testing.assert_array_equal(log.imu.acceleration[:, 2], columns["acc_z"])
    assert log.places.kind == "lonlat"
    np.testing.assert_array_equal(log.places.x, columns["lon"])
    np.testing.assert_array_equal(log.places.y, columns["lat"])
    assert log.wheels is None
    assert log.columns["rate_y"] == "gyro_y"
    assert log.name == "drive"


def test_half_an_hour_at_50_hz_is_no_damaged_file(tmp_path):
    """The process that reads has a limit of memory, which libraries must not use up by reserving."""
    columns = {name: np.round(values, 3) for name, values in drive(90_000).items()}
    log = read_drive(write(tmp_path / "long.csv", columns | {"remark": ["x" * 16] * 90_000}))
    np.testing.assert_array_equal(log.imu.rate, gyro(columns))


def test_remarks_between_rows_and_lines_before_the_header_are_skipped(tmp_path):
    columns = drive(50)
    text = (tmp_path / "drive.csv", columns)
    lines = open(write(*text), encoding="utf-8").read().splitlines()  # noqa: PTH123, SIM115
    lines.insert(20, "# a pause")
    path = tmp_path / "remarks.csv"
    path.write_text("\n".join(["Device: logger 7", "", *lines]), encoding="utf-8")
    np.testing.assert_array_equal(read_drive(str(path)).imu.rate, gyro(columns))


@pytest.mark.parametrize("pattern", ["gyro_{} [deg/s]", "gyro_{}_dps", "Gyr{} (°/s)", "w{}:deg/s"])
def test_degrees_per_second_in_names(tmp_path, pattern):
    columns = drive()
    names = [pattern.format(axis) for axis in "xyz"]
    turned = {**columns, **{name: np.rad2deg(columns[name]) for name in NAMES[1:4]}}
    log = read_drive(write(tmp_path / "a.csv", renamed(turned, **dict(zip(NAMES[1:4], names, strict=True)))))
    np.testing.assert_allclose(log.imu.rate, gyro(columns), rtol=1e-12)
    assert not any("no unit" in note for note in log.notes)


def test_rates_that_cannot_be_rad_per_s_are_refused_with_what_helps(tmp_path):
    columns = drive()
    turned = {**columns, **{name: np.rad2deg(columns[name]) for name in NAMES[1:4]}}
    path = write(tmp_path / "a.csv", turned)
    text = refusal(path)
    assert "too large for rad/s" in text
    remedy = text.split("`columns='")[1].split("'`")[0]
    np.testing.assert_allclose(read_drive(path, parse_columns(remedy)).imu.rate, gyro(columns), rtol=1e-12)


def test_columns_are_named_with_units_and_signs(tmp_path):
    columns = renamed(drive(), gyro_x="p", gyro_y="q", gyro_z="r", time="clock")
    columns["clock"] = columns["clock"] * 1e3
    path = write(tmp_path / "a.csv", columns)
    named = parse_columns("rate_x=p:deg/s, rate_y=-q[deg/s],rate_z=R[deg/s],time=clock[ms]")
    log = read_drive(path, named)
    np.testing.assert_allclose(log.imu.rate, np.deg2rad(np.stack([columns["p"], -columns["q"], columns["r"]], 1)))
    np.testing.assert_allclose(log.imu.time, columns["clock"] * 1e-3)
    assert log.columns["rate_y"] == "q [deg/s]"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("rate_y", "QUANTITY=COLUMN"),
        ("speeed=v", "speeed, which is no quantity"),
        ("rate_y=a,rate_y=b", "twice"),
    ],
)
def test_columns_in_another_form_are_refused(text, says):
    with pytest.raises(UsageError, match=says):
        parse_columns(text)


def test_a_named_column_that_is_not_there_lists_those_that_are(tmp_path):
    path = write(tmp_path / "a.csv", drive())
    text = refusal(path, {"rate_y": "gyro_q"})
    assert "rate_y=gyro_q" in text
    assert "gyro_x, gyro_y, gyro_z" in text
    assert "Units of it are: rad/s" in refusal(path, {"rate_y": "gyro_y[m]"}, UsageError)


def test_an_empty_name_leaves_a_quantity_out(tmp_path):
    columns = {**drive(), "speed": np.ones(400)}
    path = write(tmp_path / "a.csv", columns)
    assert read_drive(path).wheels is not None
    assert read_drive(path, parse_columns("speed=")).wheels is None


def test_several_files_each_at_its_own_rate(tmp_path):
    columns = drive()
    imu = write(tmp_path / "imu.csv", {name: columns[name] for name in NAMES[:7]})
    gnss = write(
        tmp_path / "gnss.csv",
        {"t": columns["time"][::10], **{name: columns[name][::10] for name in ("lon", "lat")}, "hAcc [mm]": [15] * 40},
    )
    wheels = {"time": columns["time"][::5], "velL": np.full(80, 0.9), "velR": np.full(80, 1.1)}
    log = read_drive(f"{gnss},{imu},{write(tmp_path / 'wheels.csv', wheels)}")
    assert len(log.imu.time) == 400
    np.testing.assert_array_equal(log.places.time, columns["time"][::10])
    np.testing.assert_allclose(log.places.error, 0.015)
    np.testing.assert_allclose(log.wheels.speed, 1.0)
    np.testing.assert_allclose(log.wheels.difference, 0.2)
    assert log.columns["rate_y"] == "imu.csv: gyro_y"
    assert [path.name for path in log.paths] == ["gnss.csv", "imu.csv", "wheels.csv"]


def test_one_file_at_two_rates_has_empty_cells(tmp_path):
    columns = drive()
    for name in ("lon", "lat"):
        columns[name][np.arange(400) % 10 != 3] = np.nan
    log = read_drive(write(tmp_path / "a.csv", columns))
    assert len(log.imu.time) == 400
    np.testing.assert_array_equal(log.places.time, columns["time"][3::10])


def test_positions_that_are_repeated_in_each_row_count_once(tmp_path):
    columns = drive(2000)
    place = np.minimum(np.arange(2000) // 10, 100)  # from the 100th on it stands
    columns["lon"], columns["lat"] = -99.1 + 1e-6 * place, 19.4 + 1e-6 * place
    log = read_drive(write(tmp_path / "a.csv", columns))
    np.testing.assert_allclose(log.places.time, columns["time"][:1001:10])
    assert any("only repeat" in note for note in log.notes)


@pytest.mark.parametrize(
    ("unit", "factor", "start"),
    [("s", 1, 0), ("ms", 1e3, 0), ("us", 1e6, 0), ("ns", 1e9, 0), ("ms", 1e3, 1.7e9), ("us", 1e6, 1.7e9)],
)
def test_units_of_time_are_told_from_values(tmp_path, unit, factor, start):
    columns = drive(start=start)
    whole = unit != "s"
    times = np.round(columns["time"] * factor).astype(np.int64) if whole else columns["time"]
    log = read_drive(write(tmp_path / "a.csv", {**columns, "time": times}))
    np.testing.assert_allclose(log.imu.time - start, columns["time"] - start, atol=1e-6)
    assert any(f"taken as {unit}" in note for note in log.notes) == whole


@pytest.mark.parametrize("form", ["{}", "{}Z", "{}+00:00"])
def test_dates_are_times(tmp_path, form):
    columns = drive()
    stamps = np.datetime64("2026-05-01T12:00:00.000000") + (columns["time"] * 1e6).round().astype("timedelta64[us]")
    columns["time"] = [form.format(str(stamp).replace("T", " ")) for stamp in stamps]
    log = read_drive(write(tmp_path / "a.csv", columns))
    np.testing.assert_allclose(log.imu.time - 1_777_636_800, np.arange(400) / 100, atol=1e-6)


@pytest.mark.parametrize(
    ("form", "later"),
    [
        ("{y}/{m}/{d} {t}", 0),
        ("{y}-{m}-{d}T{t}+02:00", -7200),
        ("{y}-{m}-{d} {t}-0530", 19800),
        ("{y}.{m}.{d} {t} UTC", 0),
        ("{t}", -1_777_593_600),
    ],
)
def test_other_dates_are_times(tmp_path, form, later):
    columns = drive(3000)
    stamps = np.datetime64("2026-05-01T12:00:00.000") + (columns["time"] * 1e3).round().astype("timedelta64[ms]")
    words = [str(stamp) for stamp in stamps]
    columns["time"] = [form.format(y=w[:4], m=w[5:7], d=w[8:10], t=w[11:]) for w in words]
    log = read_drive(write(tmp_path / "a.csv", columns))
    np.testing.assert_allclose(log.imu.time - 1_777_636_800 - later, np.arange(3000) / 100, atol=1e-6)


def test_date_and_time_of_day_in_two_columns(tmp_path):
    columns = drive()
    stamps = np.datetime64("2026-05-01T23:59:58.000") + (columns["time"] * 1e3).round().astype("timedelta64[ms]")
    columns["time"] = [str(stamp)[11:] for stamp in stamps]
    columns["Date"] = [str(stamp)[:10].replace("-", "/") for stamp in stamps]
    log = read_drive(write(tmp_path / "a.csv", columns))
    np.testing.assert_allclose(log.imu.time - 1_777_679_998, np.arange(400) / 100, atol=1e-6)


def test_a_track_of_rtklib_beside_an_imu(tmp_path):
    columns = drive(start=1_777_636_800.0)
    imu = write(tmp_path / "imu.csv", {name: columns[name] for name in NAMES[:7]})
    head = [
        "% program   : RTKPOST ver.2.4.3",
        "%",
        "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)",
    ]
    rows = [
        f"2026/05/01 12:00:{18 + n / 5:06.3f}   19.4{n:07d}  -99.1{n:07d}  2240.1   1  12   0.0110   0.0090   0.02"
        for n in range(20)
    ]
    (tmp_path / "ppk.pos").write_text("\n".join([*head, *rows]), encoding="utf-8")
    log = read_drive(f"{imu},{tmp_path / 'ppk.pos'}")
    np.testing.assert_allclose(log.places.time - 1_777_636_800, np.arange(20) / 5, atol=1e-6)
    np.testing.assert_allclose(log.places.x[3], -99.10000003)
    np.testing.assert_allclose(log.places.error, 0.011)
    assert any("18 s are taken off" in note for note in log.notes)


def test_files_of_a_phone_are_named_after_their_sensors(tmp_path):
    columns = drive(start=1_777_636_800.0)
    stamps = (columns["time"] * 1e9).round().astype(np.int64)
    for stem, name, late in (("Gyroscope", "gyro", 0), ("TotalAcceleration", "acc", 2_000_000)):
        axes = {axis: columns[f"{name}_{axis}"] for axis in "zyx"}
        write(tmp_path / f"{stem}.csv", {"time": stamps + late, "seconds_elapsed": columns["time"] - 5, **axes})
    log = read_drive(f"{tmp_path / 'TotalAcceleration.csv'},{tmp_path / 'Gyroscope.csv'}")
    np.testing.assert_array_equal(log.imu.rate, gyro(columns))
    late = np.interp(columns["time"], columns["time"] + 0.002, columns["acc_y"])
    np.testing.assert_allclose(log.imu.acceleration[1:, 1], late[1:], atol=1e-3)
    assert log.places is None


def test_rates_from_attitudes(tmp_path):
    time = np.arange(400) / 100
    pitch = 5.0 * np.sin(2.0 * time)
    columns = {"time": time, "roll": 0 * time, "pitch": pitch, "yaw": 30.0 + 0 * time}
    log = read_drive(write(tmp_path / "a.csv", columns))
    np.testing.assert_allclose(log.imu.rate[:, 1], np.deg2rad(10.0 * np.cos(2.0 * log.imu.time)), atol=1e-5)
    assert any("taken as deg" in note for note in log.notes)
    assert any("differences of its attitudes" in note for note in log.notes)


@pytest.mark.parametrize(("factor", "unit"), [(1 / 9.80665, "g"), (1e3 / 9.80665, "mg")])
def test_accelerations_in_g_are_told_from_gravity(tmp_path, factor, unit):
    columns = drive()
    scaled = {**columns, **{name: columns[name] * factor for name in NAMES[4:7]}}
    log = read_drive(write(tmp_path / "a.csv", scaled))
    np.testing.assert_allclose(log.imu.acceleration[:, 2], columns["acc_z"], rtol=1e-9)
    assert any(f"taken as {unit}" in note for note in log.notes)


def test_accelerations_without_gravity_are_not_used(tmp_path):
    columns = drive()
    columns["acc_z"] = columns["acc_z"] - GRAVITY
    log = read_drive(write(tmp_path / "a.csv", columns))
    assert np.isnan(log.imu.acceleration).all()
    assert any("not used" in note for note in log.notes)


def test_a_bag_exported_by_rostopic(tmp_path):
    columns = drive()
    names = {
        "gyro_x": "field.angular_velocity.x",
        "gyro_y": "field.angular_velocity.y",
        "gyro_z": "field.angular_velocity.z",
    }
    stamps = np.round(columns.pop("time") * 1e9).astype(np.int64) + 1_700_000_000 * 10**9
    exported = {"%time": stamps + 3_000_000, "field.header.stamp": stamps, **renamed(columns, **names)}
    log = read_drive(write(tmp_path / "a.csv", exported))
    np.testing.assert_allclose(log.imu.time - 1.7e9, np.arange(400) / 100, atol=1e-6)
    assert log.columns["time"] == "field.header.stamp"


def test_an_ardupilot_log_as_csv(tmp_path):
    columns = drive()
    count = 400
    imu = {
        "timestamp": np.repeat(1.7e9 + columns["time"], 2),
        "TimeUS": np.repeat((columns["time"] * 1e6).astype(np.int64), 2) + np.tile([0, 40], count),
        "I": np.tile([0, 1], count),
        **{
            f"Gyr{axis}": np.repeat(sign * columns[f"gyro_{axis.lower()}"], 2)
            for axis, sign in zip("XYZ", (1, -1, -1), strict=True)
        },
        **{
            f"Acc{axis}": np.repeat(sign * columns[f"acc_{axis.lower()}"], 2)
            for axis, sign in zip("XYZ", (1, -1, -1), strict=True)
        },
    }
    imu["GyrX"] = imu["GyrX"] + np.tile([0.0, 9.0], count)  # the second sensor is broken
    gps = {
        "timestamp": 1.7e9 + columns["time"][::20],
        "TimeUS": (columns["time"][::20] * 1e6).astype(np.int64),
        "I": np.zeros(20, int),
        "Status": np.r_[1, np.full(19, 6)],
        "Lat": columns["lat"][::20],
        "Lng": columns["lon"][::20],
        "Spd": np.ones(20),
    }
    log = read_drive(f"{write(tmp_path / 'imu.csv', imu)},{write(tmp_path / 'gps.csv', gps)}")
    np.testing.assert_allclose(log.imu.rate, gyro(columns), atol=1e-12)
    assert log.imu.acceleration[:, 2].mean() == pytest.approx(GRAVITY, abs=0.1)
    assert len(log.places.time) == 19
    assert any("I = 0" in note for note in log.notes)


def test_a_binary_ardupilot_log_is_refused_with_the_command_that_helps(tmp_path):
    path = tmp_path / "00000012.BIN"
    path.write_bytes(b"\xa3\x95\x80\x80" + bytes(200))
    text = refusal(path)
    assert "mavlogdump.py --format csv --types IMU 00000012.BIN > 00000012_imu.csv" in text


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("monday_imu", "monday_gnss"), "monday"),
        (("2026-11-22.imu", "2026-11-22.gnss"), "2026-11-22"),
        (("imu_03", "imu_04"), "imu"),
        (("drive1_imu", "drive10_gnss"), "drive1_imu,drive10_gnss"),
        (("imu", "gnss"), "imu,gnss"),
    ],
)
def test_a_drive_of_several_files_has_what_their_names_have_in_common(tmp_path, names, said):
    imu, places = (tmp_path / f"{name}.csv" for name in names)
    time = np.arange(100) * 0.02
    rates = np.column_stack([time, np.sin(time), np.cos(time), np.sin(2 * time)])
    np.savetxt(imu, rates, delimiter=",", header="time [s],gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s]", comments="")
    place = np.column_stack([time, -99 + time * 1e-6, 19 + time * 1e-6])
    np.savetxt(places, place, delimiter=",", header="time [s],longitude [deg],latitude [deg]", comments="")
    assert read_drive(f"{imu},{places}").name == said
