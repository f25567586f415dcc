"""COPC: an octree read region by region, and octrees that lie."""

import numpy as np
import pytest

from bumpymap.core.errors import BadInputError
from bumpymap.readers import PointStats, ReadOptions, open_survey
from bumpymap.readers.las import LasSurvey

INFO = 375 + 54
"""Byte of the COPC record: middle x, y, z, half side, spacing, page place and size, ..."""
US_FOOT = 1200 / 3937


MADE = {}
"""Bytes of the files that were made already: many chunks take their time."""


@pytest.fixture
def tree(las, laz):
    """An octree of 4,000 points on 400 x 400 units, 5 levels."""

    def write(epsg=None, page_levels=None):
        path = las.folder / "t.copc.laz"
        if (epsg, page_levels) not in MADE:
            plain = las.write("t.las", points(), version="1.4", fmt=7, epsg=epsg)
            MADE[epsg, page_levels] = laz.octree(plain, levels=4, page_levels=page_levels).read_bytes()
        path.write_bytes(MADE[epsg, page_levels])
        return path

    return write


def points():
    rng = np.random.default_rng(9)
    return np.round(rng.uniform([5e5, 4e6, 0], [500_400, 4_000_400, 40], (4000, 3)), 3)


def exhaust(path, options=ReadOptions()):  # noqa: B008 (frozen)
    return sum(cloud.easting.size for cloud in open_survey(path, options).clouds())


@pytest.mark.slow
@pytest.mark.parametrize(("page_levels", "size"), [(None, 1), (1, 300), (3, 100_000)])
def test_chunks_hold_all_points_each_inside_its_box(tree, batches, table, size, page_levels):
    path = tree(epsg=2276, page_levels=page_levels)
    reader = open_survey(path)
    assert reader.info.format == "COPC (LAZ 1.4, point format 7)"
    chunks = reader.chunks(size)
    found = batches(reader, size)
    for chunk, batch in zip(chunks, found, strict=True):
        box, cloud = chunk.bounds, batch.cloud
        assert cloud.easting.size == chunk.points
        assert box.west <= cloud.easting.min() <= cloud.easting.max() <= box.east
        assert box.south <= cloud.northing.min() <= cloud.northing.max() <= box.north
    got = table(found)[:, :3]
    expected = points() * US_FOOT
    assert np.array_equal(got[np.lexsort(got.T)], expected[np.lexsort(expected.T)])


def test_ground_is_complete_long_before_the_end(tree):
    """What no later chunk can reach is complete; the root alone reaches everywhere, and comes first."""
    chunks = open_survey(tree()).chunks(100)
    middles = np.stack(np.meshgrid(np.arange(8) * 50 + 25 + 5e5, np.arange(8) * 50 + 25 + 4e6), axis=-1).reshape(-1, 2)
    complete = []
    for k in range(len(chunks)):
        boxes = [chunk.bounds for chunk in chunks[k + 1 :]]
        open_ground = [
            any(box.west <= x <= box.east and box.south <= y <= box.north for box in boxes) for x, y in middles
        ]
        complete.append(1 - np.mean(open_ground))
    done = np.arange(1, len(chunks) + 1) / len(chunks)
    # A quarter of the ground behind, on average, where a file in random order would have none of it.
    assert np.all(np.array(complete) >= done - 0.35)
    assert np.interp(0.5, done, complete) > 0.25


def test_an_octree_built_around_another_place(las, tree, read):
    """Regions would be taken for complete while their points are still to come."""
    path = las.patch(tree(), INFO, "<d", 500_300.0)
    with pytest.raises(BadInputError, match=r"points of .* lie outside the octree node.*`trust_points=True`"):
        exhaust(path)
    trusted = open_survey(path, ReadOptions(trust_points=True))
    assert {chunk.bounds for chunk in trusted.chunks(300)} == {None}
    assert len(read(trusted)[0]) == 4000


@pytest.mark.slow
def test_points_outside_their_node_are_as_many_however_the_file_is_cut(las, tree):
    """Counted one by one: a point is in the cube of its node, 1 m around it allowed."""
    path = las.patch(tree(epsg=32614), INFO, "<d", 500_202.0)
    reader = LasSurvey(path, ReadOptions())
    box = reader.info.bounds
    expected = 0
    for chunk in reader.chunks(1):
        fetched = reader.fetch(chunk).view(np.uint8)
        words = fetched[:, :8].copy().view("<i4") * 0.001 + np.array([500_000.0, 4_000_000.0])
        low = np.array([chunk.bounds.west, chunk.bounds.south]) - 1
        high = np.array([chunk.bounds.east, chunk.bounds.north]) + 1
        inside = ((words >= low) & (words <= high)).all(axis=1)
        whole = ((words >= [box.west - 1, box.south - 1]) & (words <= [box.east + 1, box.north + 1])).all(axis=1)
        expected += int((whole & ~inside).sum())
    assert expected > 0
    for size in (300, 1500, 100_000):
        total = PointStats()
        for chunk in reader.chunks(size):
            batch = reader.convert(chunk, reader.fetch(chunk))
            assert batch.cloud.easting.size == (0 if batch.stats.points_outside_node else chunk.points)
            total = total.merge(batch.stats)
        assert total.points_outside_node == expected
