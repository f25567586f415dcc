"""Attitudes and angular rates against the rotations of scipy."""

import numpy as np
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from bumpymap.readers.drives.signals import Signal, body_rates, quaternions_of_angles

angle = st.floats(-3.1, 3.1)


@given(roll=angle, pitch=st.floats(-1.5, 1.5), yaw=angle)
def test_quaternions_of_angles(roll, pitch, yaw):
    found = quaternions_of_angles(*(np.array([each]) for each in (roll, pitch, yaw)))
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    assert (Rotation.from_quat(found[0]) * expected.inv()).magnitude() < 1e-9


@settings(deadline=None)
@given(
    start=st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    rate=st.lists(st.floats(-4, 4), min_size=3, max_size=3),
    step=st.floats(0.001, 0.4),
    flips=st.integers(0, 2**20),
    scale=st.floats(0.9, 1.1),
)
def test_a_steady_turn_gives_its_rate_whatever_sign_and_length_the_quaternions_have(start, rate, step, flips, scale):
    time = np.arange(12) * step
    turns = Rotation.from_quat(start) * Rotation.from_rotvec(np.outer(time, rate))
    signs = np.array([-1.0 if flips >> place & 1 else 1.0 for place in range(12)])
    found = body_rates(Signal(time, turns.as_quat() * signs[:, None] * scale))
    np.testing.assert_allclose(found.values, np.tile(rate, (11, 1)), atol=1e-6)
    np.testing.assert_allclose(found.time, (time[1:] + time[:-1]) / 2)


def test_nothing_is_known_across_a_gap():
    time = np.array([0.0, 0.1, 0.2, 5.0, 5.1])
    turns = Rotation.from_euler("y", time[:, None]).as_quat()
    found = body_rates(Signal(time, turns))
    np.testing.assert_allclose(found.time, [0.05, 0.15, 5.05])
    np.testing.assert_allclose(found.values[:, 1], 1.0)
