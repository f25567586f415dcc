import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from bumpymap.core.errors import BadInputError
from bumpymap.lab.simulate.terrain import PatchGround, Strip, strip_triangles

SIZE = 3.0


@pytest.fixture
def heights():
    return np.random.default_rng(5).normal(0, 0.2, (15, 15)) + 7.0


@pytest.fixture
def ground(heights):
    return PatchGround.from_heights(heights, SIZE)


def pixel_centres(pixels=15):
    axis = (np.arange(pixels) + 0.5) * SIZE / pixels
    return np.meshgrid(axis, axis[::-1])  # north row first


def test_pixel_centres_keep_their_heights_north_up(heights, ground):
    easting, northing = pixel_centres()
    np.testing.assert_allclose(ground.height(easting, northing), heights, atol=1e-12)


@given(
    st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)),
    arrays(np.float64, (2, 20), elements=st.floats(-40, 40)),
)
def test_a_sloping_patch_goes_on_as_its_plane_and_not_as_a_ridge(slope, points):
    easting, northing = pixel_centres()
    ground = PatchGround.from_heights(slope[0] * easting + slope[1] * northing + 2, SIZE)
    expected = slope[0] * points[0] + slope[1] * points[1] + 2
    np.testing.assert_allclose(ground.height(*points), expected, atol=1e-9)


@pytest.mark.parametrize(
    ("patch", "words"),
    [
        (np.zeros((15, 14)), "must be square"),
        (np.zeros(15), "must be square"),
        (np.zeros((1, 1)), "2 x 2"),
        (np.where(np.eye(15) > 0, np.nan, 0.0), "15 pixels that are NaN"),
    ],
)
def test_patch_that_cannot_be_driven_is_refused(patch, words):
    with pytest.raises(BadInputError, match=words):
        PatchGround.from_heights(patch, SIZE)


def upward_parts(triangles):
    a, b, c = triangles.astype(np.float64).transpose(1, 0, 2)
    return np.cross(b - a, c - a)[:, 2]


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_strip_is_covered_once_and_without_holes(ground, heading):
    strip = Strip(2.0, 4.0, heading, 6.0, 1.0)
    triangles = strip_triangles(ground, strip)
    area = upward_parts(triangles) / 2  # above 0: every triangle faces up
    cells = np.floor(triangles.mean(axis=1)[:, :2] / ground.spacing + 1e-6).astype(int)
    unique, times = np.unique(cells, axis=0, return_counts=True)
    assert set(times) == {2}
    np.testing.assert_allclose(area, ground.spacing**2 / 2, rtol=1e-3)
    forward, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    along, across = np.meshgrid(np.linspace(-0.99, 6.99, 40), np.linspace(-0.99, 0.99, 20))
    inside = np.array([2.0, 4.0]) + along[..., None] * forward + across[..., None] * left
    wanted = np.floor(inside.reshape(-1, 2) / ground.spacing).astype(int)
    assert set(map(tuple, wanted)) <= set(map(tuple, unique))
