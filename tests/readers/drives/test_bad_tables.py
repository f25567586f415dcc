"""Files that hold no drive, or a broken one: each is refused with what came, what is allowed and what to do."""

from pathlib import Path

import numpy as np
import pytest
from drive_tables import NAMES, drive, refusal, renamed, write

from bumpymap.core import BadInputError, UsageError
from bumpymap.readers import read_drive
from bumpymap.readers.drives.tables import open_table


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "is empty"),
        (b"\n \n", "is empty"),
        (b"Dear diary,\ntoday we drove, and it was bumpy.\n", "is no table"),
        (b"\x89PNG\0\0\0", "is not a text file"),
        ("time,wx\n1,2\n".encode("utf-16"), "CSV file in UTF-8"),
        (b"0.0,0.1,0.2,0.3\n0.1,0.1,0.2,0.3\n", "no header line"),
        (b"time;wx;wy;wz\n0,01;0,1;0,2;0,3\n", "decimal commas"),
        (b"time,wx,wy,wz\n" + 3 * b"0,01,0,1,0,2,0,3\n", "do not have the 4 values"),
        (b"time,wx,wy,wz\n", "is no table"),
        (b'<?xml version="1.0"?>\n<gpx><trk></trk></gpx>', "ogr2ogr and gpsbabel make CSV"),
        (b"a,b,c\n1,2,3\n", "neither angular rates nor attitudes"),
        (b"wx,wy,wz\n1,2,3\n", "no column of times"),
        (b"time,wx,wy,wz\n0,0,0,1\n1,2,0,1\n", "2 samples"),
    ],
)
def test_what_is_no_drive(tmp_path, data, says):
    path = tmp_path / "a.csv"
    path.write_bytes(data)
    assert says in refusal(path)


def test_what_is_not_there(tmp_path):
    assert "there is no file" in refusal(tmp_path / "a.csv")
    with pytest.raises(UsageError, match="is empty"):
        read_drive(" ")
    assert "folder" in refusal(tmp_path)


def test_a_message_of_missing_rates_lists_the_columns(tmp_path):
    columns = renamed(drive(), gyro_x="a1", gyro_y="a2", gyro_z="a3")
    text = refusal(write(tmp_path / "a.csv", columns))
    assert "a1, a2, a3" in text
    assert "rate_y=NAME" in text


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: c["time"].__setitem__(slice(200, None), c["time"][200:] - 1.5), "run backwards 1 times"),
        (lambda c: c.update(time=np.floor(c["time"])), "too coarse"),
        (lambda c: c["time"].fill(np.nan), "holds no times"),
        (lambda c: c.update(time=["then"] * 400), "are text such as 'then'"),
        (lambda c: c.update(gyro_y=["oops", *c["gyro_y"][1:]]), "holds 'oops'"),
        (lambda c: c["gyro_y"].fill(np.nan), "neither angular rates nor attitudes"),
        (lambda c: [c[name].fill(0.0) for name in NAMES[1:4]], "all zero"),
        (lambda c: c.update(lat=c["lon"], lon=c["lat"]), "swapped"),
        (lambda c: c["lat"].fill(1_904_322.0), "reach"),
        (lambda c: c["lat"].fill(4807.038), "without minutes"),
        (lambda c: c.update(time=c["time"] * 1e-3), "cannot be determined"),
    ],
)
def test_columns_that_cannot_be_meant(tmp_path, change, says):
    columns = drive()
    change(columns)
    assert says in refusal(write(tmp_path / "a.csv", columns))


def test_repeated_times_broken_lines_and_gaps_are_noted(tmp_path):
    columns = drive()
    columns["time"][100:103] = columns["time"][100]
    columns["time"][300:] += 2.0
    path = write(tmp_path / "a.csv", columns)
    with open(path, "a", encoding="utf-8") as stream:  # noqa: PTH123
        stream.write("6.01,0.1,0.2")
    log = read_drive(path)
    assert len(log.imu.time) == 398
    assert any("2 samples" in note and "repeat the time" in note for note in log.notes)
    assert any("1 lines" in note and "cut off" in note for note in log.notes)
    assert any("angular rates have 1 gap, the longest of 2.01 s" in note for note in log.notes)


def test_files_of_different_clocks_are_refused(tmp_path):
    columns = drive()
    imu = write(tmp_path / "imu.csv", {name: columns[name] for name in NAMES[:4]})
    gnss = write(
        tmp_path / "gnss.csv",
        {"time": columns["time"][::10] + 7210.0, "lon": columns["lon"][::10], "lat": columns["lat"][::10]},
    )
    assert "no time in common" in refusal(f"{imu},{gnss}")


def test_two_sensors_in_one_file_are_not_mixed(tmp_path):
    columns = drive()
    both = {"time": columns["time"]}
    for sensor in ("front", "rear"):
        both.update({f"{sensor}_gyro_{axis}": columns[f"gyro_{axis}"] for axis in "xyz"})
    path = write(tmp_path / "a.csv", both)
    text = refusal(path)
    assert "several sets of columns" in text
    named = dict(part.split("=") for part in text.split("`columns='")[1].split("'`")[0].split(","))
    assert read_drive(path, named).columns["rate_x"] == "front_gyro_x"


def test_the_largest_files_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("bumpymap.readers.drives.tables._MOST_BYTES", 1000)
    with pytest.raises(BadInputError, match="Cut it into several drives"):
        open_table(Path(write(tmp_path / "a.csv", drive())))


def test_degree_signs_of_other_encodings(tmp_path):
    columns = drive()
    text = (tmp_path / "a.csv", renamed(columns, **{f"gyro_{axis}": f"Gyro {axis} [°/s]" for axis in "xyz"}))
    path = tmp_path / "b.csv"
    path.write_bytes(open(write(*text), encoding="utf-8").read().encode("cp1252"))  # noqa: PTH123, SIM115
    np.testing.assert_allclose(read_drive(str(path)).imu.rate[:, 0], np.deg2rad(columns["gyro_x"]))
