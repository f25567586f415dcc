"""COPC: octrees read region by region, and octrees that lie."""

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
def tree(las):
    """An octree of 4,000 points on 400 x 400 units, 5 levels."""

    def write(epsg=None, page_levels=None):
        path = las.folder / "t.copc.laz"
        if (epsg, page_levels) not in MADE:
            plain = las.write("t.las", points(), version="1.4", fmt=7, epsg=epsg)
            MADE[epsg, page_levels] = las.octree(plain, levels=4, page_levels=page_levels).read_bytes()
        path.write_bytes(MADE[epsg, page_levels])
        return path

    return write


def points():
    rng = np.random.default_rng(9)
    return np.round(rng.uniform([5e5, 4e6, 0], [500_400, 4_000_400, 40], (4000, 3)), 3)


def check_boxes(chunks, found):
    for chunk, batch in zip(chunks, found, strict=True):
        box, cloud = chunk.bounds, batch.cloud
        assert cloud.easting.size == chunk.points
        assert box.west <= cloud.easting.min() <= cloud.easting.max() <= box.east
        assert box.south <= cloud.northing.min() <= cloud.northing.max() <= box.north


@pytest.mark.slow
@pytest.mark.parametrize(("page_levels", "size"), [(None, 1), (1, 300), (3, 100_000)])
def test_chunks_hold_all_points_each_inside_its_box(tree, batches, table, size, page_levels):
    path = tree(epsg=2276, page_levels=page_levels)
    reader = open_survey(path)
    assert reader.info.format == "COPC (LAZ 1.4, point format 7)"
    chunks = reader.chunks(size)
    found = batches(reader, size)
    check_boxes(chunks, found)
    assert np.array_equal(in_order(table(found)[:, :3]), in_order(points() * US_FOOT))


def test_an_octree_built_around_another_place(las, tree, read):
    """Regions would be taken for complete while their points are still to come."""
    path = las.patch(tree(), INFO, "<d", 500_300.0)
    with pytest.raises(BadInputError, match=r"points of .* lie outside the octree node.*`trust_points=True`"):
        list(open_survey(path).clouds())
    trusted = open_survey(path, ReadOptions(trust_points=True))
    assert {chunk.bounds for chunk in trusted.chunks(300)} == {None}
    assert len(read(trusted)[0]) == 4000


@pytest.mark.slow
def test_points_outside_their_node_are_as_many_however_the_file_is_cut(las, tree):
    """Counted one by one: a point is in the cube of its node, 1 m around it allowed."""
    reader = LasSurvey(las.patch(tree(epsg=32614), INFO, "<d", 500_202.0), ReadOptions())

    def inside(place, box):
        low, high = np.array([box.west, box.south]) - 1, np.array([box.east, box.north]) + 1
        return ((place >= low) & (place <= high)).all(axis=1)

    expected = 0
    for chunk in reader.chunks(1):
        words = reader.fetch(chunk).view(np.uint8)[:, :8].copy().view("<i4")
        place = words * 0.001 + np.array([500_000.0, 4_000_000.0])
        expected += int((inside(place, reader.info.bounds) & ~inside(place, chunk.bounds)).sum())
    assert expected > 0
    for size in (300, 1500, 100_000):
        total = PointStats()
        for chunk in reader.chunks(size):
            batch = reader.convert(chunk, reader.fetch(chunk))
            assert batch.cloud.easting.size == (0 if batch.stats.points_outside_node else chunk.points)
            total = total.merge(batch.stats)
        assert total.points_outside_node == expected


def in_order(points):
    return points[np.lexsort(points.T)]
