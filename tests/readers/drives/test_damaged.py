"""Damaged logs are read as far as they go, or refused; nothing else comes of them, and nothing is printed."""

import struct

import pytest
from drive_tables import drive, write

from bumpymap.core import BadInputError
from bumpymap.readers import read_drive

pytest.importorskip("pyulog")

from ulogs import ulog


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
