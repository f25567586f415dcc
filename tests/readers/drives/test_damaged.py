"""Damaged logs are read as far as they go, or refused; nothing else comes of them, and nothing is printed."""

import random
import struct

import pytest
from drive_tables import drive, write

from bumpymap.core import BadInputError, BumpymapError
from bumpymap.readers import read_drive

pytest.importorskip("pyulog")

from ulogs import ulog

COUNT = 150


def whole(kind, folder):
    if kind == "csv":
        with open(write(folder / "whole.csv", drive(120)), "rb") as stream:  # noqa: PTH123
            return stream.read()
    fields = ["uint64_t timestamp", "float[3] gyro_rad", "float[3] accelerometer_m_s2"]
    rows = [(4000 * n, 0.1, 0.2, 0.01 * (n % 7), 0.0, 0.1, -9.8) for n in range(120)]
    fixes = ["uint64_t timestamp", "int32_t lat", "int32_t lon", "uint8_t fix_type", "float eph"]
    places = [(40_000 * n, 194_000_000 + n, -991_000_000, 3, 0.5) for n in range(12)]
    return ulog({"sensor_combined": (fields, rows), "sensor_gps": (fixes, places)})


def mutated(data, rng):
    """Bytes changed, cut out, doubled or put in, mostly in the header."""
    made = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5, 30))):
        place = rng.randrange(min(len(made), rng.choice((300, len(made)))))
        what = rng.randrange(5)
        if what == 0:
            made[place] = rng.randrange(256)
        elif what == 1:
            del made[place : place + rng.choice((1, 3, 50, 1000))]
        elif what == 2:
            made[place:place] = bytes(rng.choices(b',;\t\n"# .-eE0123456789xyz%', k=rng.choice((1, 2, 9))))
        elif what == 3:
            made[place : place + 20] = made[rng.randrange(len(made)) :][:20]
        else:
            made[place] = rng.choice(b',;\t\n"#%-.\0')
        made = made or bytearray(b"x")
    return bytes(made)


def endless_ulog():
    """Definitions whose last message is longer than what is left: pyulog goes back by its length for ever."""
    whole = ulog({"a": (["uint64_t timestamp"], [])})
    first = whole.index(b"Fa:") - 2
    layout = whole[first : whole.index(b"A\0\0\0a") - 2]
    return whole[:first] + 1500 * layout + struct.pack("<HB", 20_000, 1) + bytes(10)


def test_a_log_that_is_read_without_end_is_refused_and_the_next_is_read(tmp_path, monkeypatch):
    (tmp_path / "endless.ulg").write_bytes(endless_ulog())
    monkeypatch.setattr("bumpymap.readers.drives.read.SECONDS", 0.5)
    with pytest.raises(BadInputError, match=r"endless\.ulg: the decoder did not finish.*damaged"):
        read_drive(str(tmp_path / "endless.ulg"))
    monkeypatch.undo()
    assert len(read_drive(write(tmp_path / "good.csv", drive(120))).imu.time) == 120


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
    monkeypatch.setattr("bumpymap.readers.drives.read.SECONDS", 2.0)
    with pytest.raises(BadInputError, match=r"^((?!did not finish).)*$"):
        read_drive(str(tmp_path / "odd.csv"))


@pytest.mark.parametrize("kind", ["csv", "ulg"])
def test_damaged_logs(kind, tmp_path, capfd):
    data, outcomes = whole(kind, tmp_path), set()
    for seed in range(COUNT):
        path = tmp_path / f"damaged.{kind}"
        path.write_bytes(mutated(data, random.Random(seed)))
        try:
            outcomes.add(len(read_drive(str(path)).imu.time) > 0)
        except BumpymapError as error:
            outcomes.add(type(error).__name__)
    assert outcomes == {True, "BadInputError"}
    assert capfd.readouterr() == ("", "")
