"""The ground of a drive along a way: gaps, interpolation, the mesh of a corridor."""

import numpy as np
import pytest
from driven_ways import ReliefGround, corridor_triangles, fill_gaps

from bumpymap.core.errors import BadInputError


def plane(rows, cols, size=0.2):
    """A plane that rises 0.1 to the east and 0.3 to the north, at the pixel centres; north row first."""
    east, north = (np.arange(cols) + 0.5) * size, (np.arange(rows)[::-1] + 0.5) * size
    return 5 + 0.1 * east[None, :] + 0.3 * north[:, None]


def test_gaps_are_filled_from_their_rim_and_nothing_else_changes():
    heights = np.random.default_rng(4).random((12, 17))
    gap = np.random.default_rng(5).random(heights.shape) < 0.6
    gap[3:9, 4:12] = True
    gap[0, 0] = False
    filled = fill_gaps(np.where(gap, np.nan, heights))
    assert np.array_equal(filled[~gap], heights[~gap])
    assert np.isfinite(filled).all()
    assert filled.min() >= heights[~gap].min()
    assert filled.max() <= heights[~gap].max()


def test_a_single_gap_is_the_mean_of_its_neighbours():
    heights = np.random.default_rng(4).random((3, 3)).astype(np.float32)
    heights[1, 1] = np.nan
    assert fill_gaps(heights)[1, 1] == pytest.approx(np.nanmean(heights.astype(float)))


def test_deep_inside_a_gap_the_nearest_height_counts():
    heights = np.full((5, 60), np.nan)
    heights[:, 0], heights[:, -1] = 1.0, 3.0
    filled = fill_gaps(heights)
    assert np.array_equal(filled[2], [1.0] * 30 + [3.0] * 30)


def test_without_any_height_there_is_no_ground():
    with pytest.raises(BadInputError, match="no height is known"):
        fill_gaps(np.full((4, 4), np.nan))


def test_heights_of_a_plane_are_exact_between_pixel_centres():
    ground = ReliefGround.from_heightmap(plane(20, 30), 0.2)
    east, north = np.random.default_rng(4).uniform(0.1, 5.9, 200), np.random.default_rng(5).uniform(0.1, 3.9, 200)
    assert ground.height(east, north) == pytest.approx(5 + 0.1 * east + 0.3 * north, abs=1e-12)
    assert ground.height(np.array([-3.0]), np.array([-3.0])) == ground.heights[0, 0]
    assert ground.sloped_at(1.0, 3.9).gradient == pytest.approx((0.1, 0.3))


def test_a_corridor_covers_the_room_beside_its_line_and_little_more():
    ground = ReliefGround.from_heightmap(np.random.default_rng(4).random((60, 60)), 0.2)
    points = np.concatenate([np.linspace((2, 3), (8, 3), 121), np.linspace((8, 3), (8, 9), 121)])
    triangles = corridor_triangles(ground, points, 1.0).astype(float)
    a, b, c = triangles.swapaxes(0, 1)
    up = np.cross(b - a, c - a)[:, 2]
    assert up == pytest.approx(ground.spacing**2, rel=1e-3)  # all seen from above, so turned the right way
    assert ground.height(a[:, 0], a[:, 1]) == pytest.approx(a[:, 2], abs=1e-4)
    apart = np.sqrt(((a[:, None, :2] - points[None]) ** 2).sum(-1).min(1))
    assert apart.max() < 1.0 + 3 * ground.spacing
    middle = triangles.mean(axis=1)[:, :2]
    place = points[::7][:, None] + np.array([[0.9, 0], [0, 0.9], [-0.9, 0], [0, -0.9]])
    nearest = np.sqrt(((place.reshape(-1, 1, 2) - middle[None]) ** 2).sum(-1)).min(1)
    assert nearest.max() < ground.spacing
