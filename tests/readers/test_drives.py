"""Drives from CSV: names and units that are known, what can be named, what is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from bumpymap.core import BadInputError, UsageError
from bumpymap.readers import parse_columns, read_drive
from bumpymap.readers.drive_signals import NAMES as KNOWN, Signal, body_rates, named_columns
from bumpymap.readers.drive_tables import open_table

GRAVITY = 9.81
NAMES = ("time", "gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z", "lon", "lat")


def drive(count=400, rate=100.0, start=0.0):
    """Columns of a drive, by the names of `NAMES`."""
    rng = np.random.default_rng(3)
    time = start + np.arange(count) / rate
    gyro = rng.normal(0.0, 0.2, (count, 3))
    acceleration = np.array([0.0, 0.0, GRAVITY]) + rng.normal(0.0, 0.5, (count, 3))
    lon, lat = -99.1 + 1e-7 * np.arange(count), 19.4 + 1e-7 * np.arange(count)
    return dict(zip(NAMES, (time, *gyro.T, *acceleration.T, lon, lat), strict=True))


def write(path, columns, separator=",", before="", end="\n"):
    """Write columns; NaN as an empty cell."""
    lines = [separator.join(columns)]
    rows = zip(*columns.values(), strict=True)
    lines += [separator.join("" if value != value else str(value) for value in row) for row in rows]  # noqa: PLR0124
    path.write_text(before + end.join(lines) + end, encoding="utf-8", newline="")
    return str(path)


def renamed(columns, **names):
    return {names.get(name, name): values for name, values in columns.items()}


def refusal(path):
    with pytest.raises(BadInputError) as caught:
        read_drive(str(path))
    return str(caught.value)


def gyro(columns):
    return np.stack([columns[f"gyro_{axis}"] for axis in "xyz"], axis=1)


@pytest.mark.parametrize(
    ("separator", "before", "end"),
    [
        (",", "", "\n"),
        (";", "\n", "\n"),
        ("\t", "", "\r\n"),
        (" ", "# made by a logger\n", "\n"),
        (",", "\ufeff", "\r\n"),
    ],
)
def test_any_separator_remark_and_line_end_gives_the_same_drive(tmp_path, separator, before, end):
    columns, path = drive(), tmp_path / "drive.csv"
    write(path, columns, separator, before, end)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:20], b"# a pause" + end.encode(), *lines[20:]]))
    log = read_drive(str(path))
    np.testing.assert_array_equal(log.imu.time, columns["time"])
    np.testing.assert_array_equal(log.imu.rate, gyro(columns))
    np.testing.assert_array_equal(log.imu.acceleration[:, 2], columns["acc_z"])
    assert log.places.kind == "lonlat"
    np.testing.assert_array_equal(log.places.x, columns["lon"])
    np.testing.assert_array_equal(log.places.y, columns["lat"])
    assert (log.wheels, log.columns["rate_y"], log.name) == (None, "gyro_y", "drive")


def test_half_an_hour_at_50_hz_is_no_damaged_file(tmp_path):
    """The process that reads has a limit of memory, which libraries must not use up by reserving."""
    columns = {name: np.round(values, 3) for name, values in drive(90_000).items()}
    log = read_drive(write(tmp_path / "long.csv", columns | {"remark": ["x" * 16] * 90_000}))
    np.testing.assert_array_equal(log.imu.rate, gyro(columns))


# ---- names and units of columns ----


def test_rates_in_degrees_are_refused_with_what_helps_unless_names_say_so(tmp_path):
    columns = drive()
    turned = columns | {name: np.rad2deg(columns[name]) for name in NAMES[1:4]}
    path = write(tmp_path / "a.csv", turned)
    text = refusal(path)
    assert "too large for rad/s" in text
    remedy = text.split("`columns='")[1].split("'`")[0]
    np.testing.assert_allclose(read_drive(path, parse_columns(remedy)).imu.rate, gyro(columns), rtol=1e-12)
    path = write(tmp_path / "b.csv", renamed(turned, **{f"gyro_{axis}": f"Gyro_{axis} [deg/s]" for axis in "xyz"}))
    np.testing.assert_allclose(read_drive(path).imu.rate, gyro(columns), rtol=1e-12)


def test_columns_are_named_with_units_and_signs_and_left_out_by_an_empty_name(tmp_path):
    columns = renamed(drive(), gyro_x="p", gyro_y="q", gyro_z="r", time="clock") | {"speed": np.ones(400)}
    columns["clock"] = columns["clock"] * 1e3
    path = write(tmp_path / "a.csv", columns)
    named = "rate_x=p:deg/s, rate_y=-q[deg/s],rate_z=R[deg/s],time=clock[ms]"
    log = read_drive(path, parse_columns(named))
    np.testing.assert_allclose(log.imu.rate, np.deg2rad(np.stack([columns["p"], -columns["q"], columns["r"]], 1)))
    np.testing.assert_allclose(log.imu.time, columns["clock"] * 1e-3)
    assert log.columns["rate_y"] == "q [deg/s]"
    np.testing.assert_array_equal(log.wheels.speed, 1.0)
    assert read_drive(path, parse_columns(named + ",speed=")).wheels is None


@pytest.mark.parametrize(
    ("text", "error", "says"),
    [
        ("rate_y", UsageError, "QUANTITY=COLUMN"),
        ("speeed=v", UsageError, "speeed, which is no quantity"),
        ("rate_y=a,rate_y=b", UsageError, "twice"),
        ("rate_y=gyro_y[m]", UsageError, "Units of it are: rad/s"),
        ("rate_y=gyro_q", BadInputError, r"rate_y=gyro_q.*gyro_x, gyro_y, gyro_z"),
    ],
)
def test_columns_in_another_form_or_that_are_not_there_are_refused(tmp_path, text, error, says):
    path = write(tmp_path / "a.csv", drive(10))
    with pytest.raises(error, match=says):
        read_drive(path, parse_columns(text))


def test_columns_are_known_by_name_with_their_unit_in_brackets_and_no_others():
    for name, quantity in KNOWN.items():
        assert named_columns("a.csv", ["height", name.upper()]) == {quantity: (name.upper(), None, 1.0)}
    found = named_columns("a.csv", ["time(ms)", "GYRO_Y [mdeg/s]", "lat [dege7]", "speed [km/h]", "Gyroscope x"])
    assert {quantity: each.unit for quantity, each in found.items()} == {
        "time": "ms", "rate_y": "mdeg/s", "latitude": "dege7", "speed": "km/h"
    }  # fmt: skip
    with pytest.raises(BadInputError, match=r"unit 'dps', which is none of rad/s.*rate_x=wx \[dps\]\[rad/s\]"):
        named_columns("a.csv", ["wx [dps]"])
    with pytest.raises(BadInputError, match=r"two columns of rate_x: wx, gyro_x\. Name one"):
        named_columns("a.csv", ["wx", "gyro_x"])
    assert named_columns("a.csv", ["wx", "gyro_x"], {"rate_x"}) == {}


def test_a_stated_unit_takes_the_place_of_an_unknown_one(tmp_path):
    columns = drive()
    turned = {name: np.rad2deg(columns[name]) for name in NAMES[1:4]}
    path = write(tmp_path / "a.csv", renamed(columns | turned, gyro_x="gyro_x [dps]"))
    assert "'dps'" in refusal(path)
    named = {"rate_x": "gyro_x [dps][deg/s]", "rate_y": "gyro_y[deg/s]", "rate_z": "gyro_z[deg/s]"}
    np.testing.assert_allclose(read_drive(path, named).imu.rate, gyro(columns), rtol=1e-12)


# ---- times ----


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_times_are_seconds_unless_a_unit_is_stated(tmp_path, unit, factor):
    columns = drive(start=1.7e9)
    times = np.round(columns["time"] * factor).astype(np.int64)
    log = read_drive(write(tmp_path / "a.csv", renamed(columns | {"time": times}, time=f"time [{unit}]")))
    np.testing.assert_allclose(log.imu.time - 1.7e9, columns["time"] - 1.7e9, atol=1e-6)
    text = refusal(write(tmp_path / "a.csv", {**columns, "time": times}))
    assert "`columns='time=NAME[ms]'`" in text


@pytest.mark.parametrize(
    ("form", "later"), [("{} {}", 0), ("{}T{}Z", 0), ("{} {}Z", 0), ("{}T{}+02:00", -7200), ("{} {}-0530", 19800)]
)
@pytest.mark.parametrize("between", "-/")
def test_dates_are_times(tmp_path, form, later, between):
    """Over midnight."""
    columns, start = drive(3000), np.datetime64("2026-05-01T23:59:45.000")
    words = [str(stamp) for stamp in start + (columns["time"] * 1e3).round().astype("timedelta64[ms]")]
    columns["time"] = [form.format(word[:10].replace("-", between), word[11:]) for word in words]
    log = read_drive(write(tmp_path / "a.csv", columns))
    np.testing.assert_allclose(log.imu.time - start.astype(float) / 1e3 - later, np.arange(3000) / 100, atol=1e-6)


def test_a_track_of_rtklib_beside_an_imu(tmp_path):
    columns = drive(start=1_777_636_800.0)
    imu = write(tmp_path / "imu.csv", {name: columns[name] for name in NAMES[:7]})
    head = "%  GPST  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
    rows = [
        f"2026/05/01 12:00:{18 + n / 5:06.3f}   19.4{n:07d}  -99.1{n:07d}  2240.1   1  12   0.0110   0.0090   0.02"
        for n in range(20)
    ]
    track = tmp_path / "ppk.pos"
    track.write_text("\n".join(["% program   : RTKPOST ver.2.4.3", "%", head, *rows]), encoding="utf-8")
    log = read_drive(f"{imu},{track}")
    np.testing.assert_allclose(log.places.time - 1_777_636_800, np.arange(20) / 5, atol=1e-6)
    np.testing.assert_allclose(log.places.x[3], -99.10000003)
    np.testing.assert_allclose(log.places.error, 0.011)
    assert any("18 s are taken off" in note for note in log.notes)


# ---- several files, several rates ----


def test_several_files_each_at_its_own_rate(tmp_path):
    columns = drive()
    imu = write(tmp_path / "imu.csv", {name: columns[name] for name in NAMES[:7]})
    seen = {name: columns[name][::10] for name in ("lon", "lat")}
    gnss = write(tmp_path / "gnss.csv", {"time": columns["time"][::10], **seen, "error [mm]": [15] * 40})
    wheels = {"time": columns["time"][::5], "velL": np.full(80, 0.9), "velR": np.full(80, 1.1)}
    log = read_drive(f"{gnss},{imu},{write(tmp_path / 'wheels.csv', wheels)}")
    assert len(log.imu.time) == 400
    np.testing.assert_array_equal(log.places.time, columns["time"][::10])
    np.testing.assert_allclose(log.places.error, 0.015)
    np.testing.assert_allclose(log.wheels.speed, 1.0)
    np.testing.assert_allclose(log.wheels.difference, 0.2)
    assert log.columns["rate_y"] == "imu.csv: gyro_y"
    assert [path.name for path in log.paths] == ["gnss.csv", "imu.csv", "wheels.csv"]
    late = write(tmp_path / "late.csv", {"time": columns["time"][::10] + 7210.0, **seen})
    assert "no time in common" in refusal(f"{imu},{late}")


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
    columns, parts = drive(), (NAMES[:4], ("time", "lon", "lat"))
    places = [
        write(tmp_path / f"{name}.csv", {column: columns[column] for column in part})
        for name, part in zip(names, parts, strict=True)
    ]
    assert read_drive(",".join(places)).name == said


def test_positions_count_once_where_cells_are_empty_or_repeat_the_last_one(tmp_path):
    columns, place = drive(2000), np.minimum(np.arange(2000) // 10, 100)  # from the 100th on it stands
    empty = {name: np.where(np.arange(2000) % 10 == 3, columns[name], np.nan) for name in ("lon", "lat")}
    log = read_drive(write(tmp_path / "a.csv", columns | empty))
    assert len(log.imu.time) == 2000
    np.testing.assert_array_equal(log.places.time, columns["time"][3::10])
    repeated = {"lon": -99.1 + 1e-6 * place, "lat": 19.4 + 1e-6 * place}
    log = read_drive(write(tmp_path / "a.csv", columns | repeated))
    np.testing.assert_allclose(log.places.time, columns["time"][:1001:10])
    assert any("only repeat" in note for note in log.notes)


def test_an_ardupilot_log_as_csv(tmp_path):
    columns, micros = drive(), np.arange(400) * 10_000
    imu = {
        "timestamp": np.repeat(1.7e9 + columns["time"], 2),
        "TimeUS": np.repeat(micros, 2) + np.tile([0, 40], 400),
        "I": np.tile([0, 1], 400),
    }
    for name, column in (("Gyr", "gyro"), ("Acc", "acc")):
        for axis, sign in zip("XYZ", (1, -1, -1), strict=True):
            imu[name + axis] = np.repeat(sign * columns[f"{column}_{axis.lower()}"], 2)
    imu["GyrX"] = imu["GyrX"] + np.tile([0.0, 9.0], 400)  # the second sensor is broken
    gps = {"timestamp": 1.7e9 + columns["time"], "TimeUS": micros, "I": np.zeros(400, int)}
    gps |= {"Status": np.r_[[1] * 20, [6] * 380], "Lat": columns["lat"], "Lng": columns["lon"], "Spd": np.ones(400)}
    gps = {name: values[::20] for name, values in gps.items()}
    log = read_drive(f"{write(tmp_path / 'imu.csv', imu)},{write(tmp_path / 'gps.csv', gps)}")
    np.testing.assert_allclose(log.imu.rate, gyro(columns), atol=1e-12)
    assert log.imu.acceleration[:, 2].mean() == pytest.approx(GRAVITY, abs=0.1)
    assert len(log.places.time) == 19
    assert any("I = 0" in note for note in log.notes)


# ---- attitudes and accelerations ----


@given(
    start=st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    rate=st.lists(st.floats(-4, 4), min_size=3, max_size=3),
    step=st.floats(0.001, 0.4),
    flips=st.integers(0, 2**20),
    scale=st.floats(0.9, 1.1),
)
def test_a_steady_turn_gives_its_rate_whatever_sign_and_length_the_quaternions_have(start, rate, step, flips, scale):
    time = np.arange(12) * step
    turns = Rotation.from_quat(start) * Rotation.from_rotvec(np.outer(time, rate))
    signs = np.array([-1.0 if flips >> place & 1 else 1.0 for place in range(12)])
    found = body_rates(Signal(time, turns.as_quat() * signs[:, None] * scale))
    np.testing.assert_allclose(found.values, np.tile(rate, (11, 1)), atol=1e-6)
    np.testing.assert_allclose(found.time, (time[1:] + time[:-1]) / 2)


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_rates_from_angles_are_those_of_scipy_and_none_across_a_gap(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    time = np.concatenate([np.arange(100), np.arange(600, 700)]) / 100
    rate = rng.uniform(-0.6, 0.6, 3)
    turns = Rotation.random(random_state=rng.integers(1 << 30)) * Rotation.from_rotvec(np.outer(time, rate))
    angles = dict(zip(("yaw", "pitch", "roll"), turns.as_euler("ZYX", degrees=True).T, strict=True))
    path = tmp_path_factory.mktemp("drive") / "a.csv"
    log = read_drive(write(path, {"time": time, **{f"{name} [deg]": values for name, values in angles.items()}}))
    np.testing.assert_allclose(log.imu.rate, np.tile(rate, (198, 1)), atol=1e-6)
    np.testing.assert_allclose(log.imu.time, np.delete((time[1:] + time[:-1]) / 2, 99))
    assert "`columns='roll=roll[deg],pitch=pitch[deg],yaw=yaw[deg]'`" in refusal(write(path, {"time": time, **angles}))
    assert any("differences of its attitudes" in note for note in log.notes)


@pytest.mark.parametrize(("factor", "unit"), [(1 / 9.80665, "g"), (1e3 / 9.80665, "mg")])
def test_accelerations_in_g_say_so_and_without_gravity_are_not_used(tmp_path, factor, unit):
    columns = drive()
    scaled = columns | {name: columns[name] * factor for name in NAMES[4:7]}
    path = write(tmp_path / "a.csv", renamed(scaled, **{name: f"{name} [{unit}]" for name in NAMES[4:7]}))
    log = read_drive(path)
    np.testing.assert_allclose(log.imu.acceleration[:, 2], columns["acc_z"], rtol=1e-9)
    log = read_drive(write(tmp_path / "b.csv", columns | {"acc_z": columns["acc_z"] - GRAVITY}))
    assert np.isnan(log.imu.acceleration).all()
    assert any("not used" in note for note in log.notes)


# ---- what is refused, and what is noted ----


def test_what_is_not_there_or_too_large(tmp_path, monkeypatch):
    assert "there is no file" in refusal(tmp_path / "a.csv")
    assert "folder" in refusal(tmp_path)
    with pytest.raises(UsageError, match="is empty"):
        read_drive(" ")
    monkeypatch.setattr("bumpymap.readers.drive_tables._MOST_BYTES", 1000)
    with pytest.raises(BadInputError, match="Cut it into several drives"):
        open_table(Path(write(tmp_path / "a.csv", drive())))


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (b"\n \n", "is empty"),
        (b"Dear diary\ntoday we drove, and it was bumpy.\n", "neither angular rates nor attitudes"),
        (b"\x89PNG\0\0\0", "is not a text file"),
        ("time,wx\n1,2\n".encode("utf-16"), "CSV file in UTF-8"),
        (b"0.0,0.1,0.2,0.3\n0.1,0.1,0.2,0.3\n", "no header line"),
        (b"time;wx;wy;wz\n0;0,1;0,2;0,3\n", "which have a point (0.25)"),
        (b"time,wx,wy,wz\n" + 3 * b"0,01,0,1,0,2,0,3\n", "do not have the 4 values"),
        (b"time,wx,wy,wz\n", "no samples"),
        (b'<?xml version="1.0"?>\n<gpx><trk></trk></gpx>', "ogr2ogr and gpsbabel make CSV"),
        (b"wx,wy,wz\n1,2,3\n", "no column named time"),
        (b"time,wx,wy,wz\n0,0,0,1\n1,2,0,1\n", "2 samples"),
        (b"\xa3\x95\x80\x80" + bytes(200), "mavlogdump.py --format csv --types IMU log.BIN > log_imu.csv"),
        (lambda c: c["time"].__setitem__(slice(200, None), c["time"][200:] - 1.5), "run backwards 1 times"),
        (lambda c: c.update(time=np.floor(c["time"])), "too coarse"),
        (lambda c: c["time"].fill(np.nan), "holds no times"),
        (lambda c: c.update(time=["then"] * 400), "are text such as 'then'"),
        (lambda c: c.update(gyro_y=["oops", *c["gyro_y"][1:]]), "holds 'oops'"),
        (lambda c: c["gyro_y"].fill(np.nan), "neither angular rates nor attitudes"),
        (lambda c: c.update(a=c.pop("gyro_x"), b=c.pop("gyro_y")), "gyro_z, acc_x, acc_y, acc_z, lon, lat, a, b"),
        (lambda c: [c[name].fill(0.0) for name in NAMES[1:4]], "all zero"),
        (lambda c: c.update(lat=c["lon"], lon=c["lat"]), "swapped"),
        (lambda c: c["lat"].fill(1_904_322.0), "reach"),
        (lambda c: c["lat"].fill(4807.038), "without minutes"),
    ],
)
def test_what_is_no_drive_or_holds_columns_that_cannot_be_meant(tmp_path, made, says):
    path = tmp_path / ("log.BIN" if "BIN" in says else "a.csv")
    if isinstance(made, bytes):
        path.write_bytes(made)
    else:
        columns = drive()
        made(columns)
        write(path, columns)
    assert says in refusal(path)


def test_repeated_times_broken_lines_and_gaps_are_noted(tmp_path):
    columns = drive()
    columns["time"][100:103] = columns["time"][100]
    columns["time"][300:] += 2.0
    path = tmp_path / "a.csv"
    write(path, columns)
    path.write_text(path.read_text() + "6.01,0.1,0.2")
    log = read_drive(str(path))
    assert len(log.imu.time) == 398
    assert any("2 samples" in note and "repeat the time" in note for note in log.notes)
    assert any("1 lines" in note and "cut off" in note for note in log.notes)
    assert any("angular rates have 1 gap, the longest of 2.01 s" in note for note in log.notes)


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("time," + "[" * 200_000 + ",a,b", "1,2,3,4"),
        (",".join("x" * 60_000), ",".join("1" * 60_000)),
        ("time,a,b", "1" * 200_000 + "x,2,3"),
        ("time x y", "0 1 2\n1 2" + " " * 300_000 + "3"),
    ],
)
def test_odd_tables_take_no_longer_than_others(tmp_path, monkeypatch, head, row):
    (tmp_path / "odd.csv").write_text(f"{head}\n{row}\n")
    monkeypatch.setattr("bumpymap.readers.drives.SECONDS", 2.0)
    with pytest.raises(BadInputError, match=r"^((?!did not finish).)*$"):
        read_drive(str(tmp_path / "odd.csv"))


@pytest.mark.realdata
def test_every_drive_of_a_real_robot_is_read(shared_data):
    """BorealTC: IMU and wheel speeds in two files each."""
    files = sorted((shared_data / "drives" / "borealtc").glob("*/imu_*.csv"))
    if not files:
        pytest.skip("../shared/data/drives/borealtc is not here")
    for imu in files:
        log = read_drive(f"{imu},{imu.with_name(imu.name.replace('imu', 'pro'))}")
        rows = np.loadtxt(imu, delimiter=",", skiprows=1)
        np.testing.assert_array_equal(log.imu.time, rows[:, 0])
        np.testing.assert_array_equal(log.imu.rate, rows[:, 1:4])
        np.testing.assert_array_equal(log.imu.acceleration, rows[:, 4:])
        assert 8.0 < np.median(np.linalg.norm(log.imu.acceleration, axis=1)) < 11.5
        assert log.places is None
        assert np.isfinite(log.wheels.difference).all()
        assert not log.notes
