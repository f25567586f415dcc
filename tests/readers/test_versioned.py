"""A file that does not stay the same while it is read: no mixture of two files comes of it, and no word of damage.

And the checksum that is made of a file while it is read.
"""

import os

import numpy as np
import pytest

import bumpymap.readers.las as las_module
from bumpymap.core import hash_file, run_spec
from bumpymap.core.config import FeatureSettings
from bumpymap.core.errors import BadInputError
from bumpymap.readers import PointStats, PointSummaryBuilder, ReadOptions, open_survey, protocol
from bumpytiles import Grid

COUNT = 3000
POINTS = np.round(np.random.default_rng(1).uniform(0, 50, (COUNT, 3)), 3) + np.array([500_000.0, 4_000_000.0, 0.0])


def write_ply(path, points, kind):
    head = f"ply\nformat {kind} 1.0\nelement vertex {COUNT}\n" + "".join(f"property double {n}\n" for n in "xyz")
    with path.open("wb") as file:
        file.write((head + "end_header\n").encode())
        if kind == "ascii":
            np.savetxt(file, points, "%.3f")
        else:
            file.write(points.astype("<f8").tobytes())
    return path


def write_pcd(path, points, data):
    head = f"VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {COUNT}\nHEIGHT 1\n"
    with path.open("wb") as file:
        file.write(f"{head}VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {COUNT}\nDATA {data}\n".encode())
        if data == "ascii":
            np.savetxt(file, points, "%.3f")
        else:
            file.write(points.astype("<f8").tobytes())
    return path


FORMATS = {
    "las": lambda las, _, points: las.write(points=points),
    "laz": lambda las, laz, points: laz.pack(las.write(points=points, version="1.4", fmt=6), 500),
    "copc": lambda las, laz, points: laz.octree(las.write(points=points, version="1.4", fmt=6)),
    "ply": lambda las, _, points: write_ply(las.folder / "a.ply", points, "binary_little_endian"),
    "text ply": lambda las, _, points: write_ply(las.folder / "a.ply", points, "ascii"),
    "pcd": lambda las, _, points: write_pcd(las.folder / "a.pcd", points, "binary"),
    "text pcd": lambda las, _, points: write_pcd(las.folder / "a.pcd", points, "ascii"),
}


def later(path):
    """Move the time of change on, as a write at a later moment does."""
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 1_000_000_000))


def raise_heights(las, laz, make, path):
    """Write the survey again, 5 m higher."""
    before = path.stat().st_mtime_ns
    assert make(las, laz, POINTS + np.array([0.0, 0.0, 5.0])) == path
    os.utime(path, ns=(0, before + 1_000_000_000))


@pytest.mark.parametrize("kind", FORMATS)
def test_a_survey_that_is_written_again_between_two_chunks(las, laz, kind):
    make = FORMATS[kind]
    path = make(las, laz, POINTS)
    reader = open_survey(path)
    chunks = reader.clouds(500)
    next(chunks)
    raise_heights(las, laz, make, path)
    with pytest.raises(BadInputError, match=rf"{path.name} changed while it was read.*Run\s+again"):
        list(chunks)


@pytest.mark.parametrize("kind", ["laz", "text ply"])
def test_a_survey_that_goes_away_between_two_chunks(las, laz, kind):
    path = FORMATS[kind](las, laz, POINTS)
    chunks = open_survey(path).clouds(500)
    next(chunks)
    path.unlink()
    with pytest.raises(BadInputError, match="changed while it was read: it was removed"):
        list(chunks)


def test_a_change_while_the_header_is_read(las, laz, monkeypatch):
    path = FORMATS["las"](las, laz, POINTS)
    whole = las.write(name="b.las", points=POINTS[:10]).read_bytes()

    def read_and_change(*arguments):
        path.write_bytes(whole[:200])
        return original(*arguments)

    original = las_module.read_raw_header
    monkeypatch.setattr(las_module, "read_raw_header", read_and_change)
    with pytest.raises(BadInputError, match="changed while it was read"):
        open_survey(path)


def test_one_that_stays_the_same_is_read_and_says_which_version_it_is(las, laz):
    path = FORMATS["laz"](las, laz, POINTS)
    reader = open_survey(path)
    assert reader.info.version == {"size": path.stat().st_size, "mtime_ns": str(path.stat().st_mtime_ns)}
    assert PointSummaryBuilder(Grid(3.0, 15), FeatureSettings()).read(reader).summary().points == COUNT


@pytest.fixture
def read_again(monkeypatch):
    """The number of bytes that were read only for a checksum, of pieces of 1 kB."""
    monkeypatch.setattr(run_spec, "PIECE", 1 << 10)
    sizes, original = [], protocol.read_range

    def read_range(path, start, size):
        sizes.append(size)
        return original(path, start, size)

    monkeypatch.setattr(protocol, "read_range", read_range)
    return sizes


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("points", [130, COUNT])
def test_the_checksum_is_made_while_the_file_is_read(las, laz, kind, points, read_again):
    path = FORMATS[kind](las, laz, POINTS)
    reader = open_survey(path, ReadOptions(checksum=True))
    assert reader.checksum is None
    assert sum(cloud.easting.size for cloud in reader.clouds(points)) == COUNT
    assert reader.checksum == hash_file(path)
    if kind not in {"copc", "text ply", "text pcd"}:  # parts in the order of the octree; streams are not hashed
        assert sum(read_again) <= 1 << 13  # header, chunk table


@pytest.mark.parametrize("kind", FORMATS)
def test_the_checksum_does_not_depend_on_the_order(las, laz, kind, read_again):
    path = FORMATS[kind](las, laz, POINTS)
    reader = open_survey(path, ReadOptions(checksum=True))
    stats = PointStats()
    for chunk in reader.chunks(500)[::-1]:
        stats = stats.merge(reader.convert(chunk, reader.fetch(chunk)).stats)
    reader.verify(stats)
    assert reader.checksum == hash_file(path)
    assert kind in {"copc", "text ply", "text pcd"} or sum(read_again) <= 1 << 13


def test_no_checksum_unless_it_is_asked_for(las, laz, read_again):
    reader = open_survey(FORMATS["las"](las, laz, POINTS))
    list(reader.clouds())
    assert reader.checksum is None
    assert read_again == []


def test_a_change_before_the_checksum_is_complete(las, laz, monkeypatch):
    path = FORMATS["laz"](las, laz, POINTS)
    reader = open_survey(path, ReadOptions(checksum=True))
    original = protocol.read_range

    def read_range(*arguments):
        later(path)
        return original(*arguments)

    monkeypatch.setattr(protocol, "read_range", read_range)
    with pytest.raises(BadInputError, match="the same size, but was written again"):
        list(reader.clouds())
    assert path.exists()
