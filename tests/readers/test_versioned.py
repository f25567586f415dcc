"""A file that does not stay the same while it is read: no mixture of two files comes of it, and no word of damage.

And the checksum that is made of a file while it is read.
"""

import os

import numpy as np
import pytest
from survey_kinds import KINDS, STREAMED, write_kind

import bumpymap.readers.las as las_module
from bumpymap.core import run_spec
from bumpymap.core.config import FeatureSettings
from bumpymap.core.errors import BadInputError
from bumpymap.readers import PointStats, PointSummaryBuilder, ReadOptions, hash_survey, open_survey, protocol
from bumpytiles import Grid

COUNT = 3000
POINTS = np.round(np.random.default_rng(1).uniform(0, 50, (COUNT, 3)), 3) + np.array([500_000.0, 4_000_000.0, 0.0])


def later(path):
    """Move the time of change on, as a write at a later moment does."""
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 1_000_000_000))


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "packed pcd"])
def test_a_survey_that_is_written_again_between_two_chunks(tmp_path, kind):
    path = write_kind(kind, tmp_path, POINTS)
    chunks, before = open_survey(path).clouds(500), path.stat().st_mtime_ns
    next(chunks)
    assert write_kind(kind, tmp_path, POINTS + np.array([0.0, 0.0, 5.0])) == path
    os.utime(path, ns=(0, before + 1_000_000_000))
    with pytest.raises(BadInputError, match=rf"{path.name} changed while it was read.*Run\s+again"):
        list(chunks)


@pytest.mark.parametrize("kind", ["laz", "text ply"])
def test_a_survey_that_goes_away_between_two_chunks(tmp_path, kind):
    path = write_kind(kind, tmp_path, POINTS)
    chunks = open_survey(path).clouds(500)
    next(chunks)
    path.unlink()
    with pytest.raises(BadInputError, match="changed while it was read: it was removed"):
        list(chunks)


def test_a_change_while_the_header_is_read(tmp_path, monkeypatch):
    path = write_kind("las", tmp_path, POINTS)
    whole = path.read_bytes()

    def read_and_change(*arguments):
        path.write_bytes(whole[:200])
        return original(*arguments)

    original = las_module.read_raw_header
    monkeypatch.setattr(las_module, "read_raw_header", read_and_change)
    with pytest.raises(BadInputError, match="changed while it was read"):
        open_survey(path)


def test_one_that_stays_the_same_is_read_and_says_which_version_it_is(tmp_path):
    path = write_kind("laz", tmp_path, POINTS)
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


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("points", [130, COUNT])
def test_the_checksum_is_made_while_the_file_is_read_in_any_order(tmp_path, kind, points, read_again):
    path = write_kind(kind, tmp_path, POINTS)
    reader = open_survey(path, ReadOptions(checksum=True))
    assert reader.checksum is None
    stats = PointStats()
    for chunk in reader.chunks(points)[::-1]:
        stats = stats.merge(reader.convert(chunk, reader.fetch(chunk)).stats)
    reader.verify(stats)
    assert stats.points == COUNT
    assert reader.checksum == hash_survey(path)
    if kind not in {"copc", *STREAMED}:  # parts in the order of the octree; streams are not hashed
        assert sum(read_again) <= 1 << 13  # header, chunk table


def test_no_checksum_unless_it_is_asked_for(tmp_path, read_again):
    reader = open_survey(write_kind("las", tmp_path, POINTS))
    assert sum(cloud.easting.size for cloud in reader.clouds(130)) == COUNT
    assert reader.checksum is None
    assert read_again == []


def test_a_change_before_the_checksum_is_complete(tmp_path, monkeypatch):
    path = write_kind("laz", tmp_path, POINTS)
    reader = open_survey(path, ReadOptions(checksum=True))
    original = protocol.read_range

    def read_range(*arguments):
        later(path)
        return original(*arguments)

    monkeypatch.setattr(protocol, "read_range", read_range)
    with pytest.raises(BadInputError, match="the same size, but was written again"):
        list(reader.clouds())
    assert path.exists()
