"""Points of messages in any layout of fields, against the arrays they were made from."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

pytest.importorskip("rosbags")

from bags import LIDAR, as_rclpy, cloud, lidar_rows

from bumpymap.core import BadInputError
from bumpymap.readers import points_of
from bumpymap.readers.frames.raw import read_cloud


@st.composite
def layouts(draw):
    """Fields in any order and at any offset, of any type, with padding after each."""
    order = draw(st.sampled_from("<>"))
    names = draw(st.permutations(["x", "y", "z", "intensity", "ring", "t"]))
    names = [name for name in names if name in "xyz" or draw(st.booleans())]
    kinds = {"intensity": ["f4", "u1", "u2"], "ring": ["u1", "u2", "i4"], "t": ["u4", "f8", "f4"]}
    offsets, formats, end = [], [], 0
    for name in names:
        kind = draw(st.sampled_from(kinds.get(name, ["f4", "f8"])))
        end += draw(st.integers(0, 5))
        offsets.append(end)
        formats.append(order + kind)
        end += np.dtype(kind).itemsize
    step = end + draw(st.integers(0, 7))
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})


@settings(max_examples=60, deadline=None)
@given(layouts(), st.integers(1, 4), st.integers(1, 9), st.integers(0, 40), st.integers(0, 2**32 - 1))
def test_points_of_any_layout(dtype, height, width, padding, seed):
    rng = np.random.default_rng(seed)
    rows = np.zeros((height, width), dtype)
    for name in dtype.names:
        rows[name] = rng.uniform(0, 100, (height, width))
    rows["y"][rng.random((height, width)) < 0.2] = np.nan
    message = cloud(rows, row_step=width * dtype.itemsize + padding)
    expected = np.stack([rows[axis].astype(np.float32) for axis in "xyz"], axis=-1).reshape(-1, 3)
    for each in (message, as_rclpy(message)):
        found = points_of(each)
        np.testing.assert_array_equal(found, expected)
        assert (found.dtype, found.flags.c_contiguous, found.flags.writeable) == (np.float32, True, True)
    intensity = read_cloud(message).intensity
    if "intensity" in dtype.names:
        np.testing.assert_array_equal(intensity, rows["intensity"].astype(np.float32).ravel())
    else:
        assert intensity is None


def test_a_cloud_without_points():
    message = cloud(np.zeros((0,), LIDAR))
    assert points_of(message).shape == (0, 3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"data": np.zeros(100, np.uint8)}, "holds 100 bytes"),
        ({"width": 2000}, "1 x 2,000 points of 32 bytes"),
        ({"height": 2, "row_step": 8}, "in rows of 8"),
        ({"point_step": 6}, "outside of its 6 bytes"),
        ({"fields": []}, "has no x, y, z; its fields are none"),
    ],
)
def test_messages_that_contradict_themselves(change, words):
    message = cloud(lidar_rows(np.ones((1000, 3))))
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(BadInputError, match=words):
        points_of(message)


def test_a_field_of_several_numbers_is_no_coordinate():
    message = cloud(lidar_rows(np.ones((10, 3))))
    message.fields[2].count = 3
    with pytest.raises(BadInputError, match="has no z"):
        points_of(message)
