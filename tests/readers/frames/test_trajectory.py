"""Chains of transforms, against their products."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bumpymap.readers.frames.transforms import FrameTree

START = 1_700_000_000


def vector(**values):
    return SimpleNamespace(**values)


def nanoseconds(seconds):
    return np.rint(np.asarray(seconds) * 1e9).astype(np.int64)


def stamp(seconds):
    sec, nanosec = divmod(int(nanoseconds(seconds)), 10**9)
    return vector(sec=sec, nanosec=nanosec)


def link(parent, child, pose, seconds=0.0):
    turn, place = pose
    x, y, z, w = turn.as_quat()
    return vector(
        header=vector(frame_id=parent, stamp=stamp(seconds)),
        child_frame_id=child,
        transform=vector(
            translation=vector(**dict(zip("xyz", place, strict=True))), rotation=vector(x=x, y=y, z=z, w=w)
        ),
    )


def matrix(pose):
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = pose[0].as_matrix(), pose[1]
    return found


def random_pose(rng):
    return Rotation.random(random_state=rng.integers(2**31)), rng.normal(0, 20, 3)


@pytest.mark.parametrize("fixed", ["map", "odom"])
@pytest.mark.parametrize("seed", range(5))
def test_a_chain_of_transforms_is_their_product(fixed, seed):
    rng = np.random.default_rng(seed)
    tree, steps = FrameTree(), {}
    names = ["earth", "map", "odom", "base", "mast", "lidar"][1 if fixed == "map" else 2 :]
    for parent, child in pairwise(names):
        steps[child] = random_pose(rng)
        static = child in {"mast", "lidar"}
        for seconds in [0] if static else [START, START + 1]:
            tree.add(vector(transforms=[link(f"/{parent}", child, steps[child], seconds)]), static=static)
    tree.add(vector(transforms=[link("base", "wheel", random_pose(rng), START)]), static=False)
    track = tree.track("lidar", START * 10**9, np.array([0.5, 1.5]))
    expected = np.eye(4)
    for child in names[1:]:
        expected = expected @ matrix(steps[child])
    assert track.covers(np.array([0.5, 1.5])).tolist() == [True, False]
    np.testing.assert_array_equal(track.times, [0.0, 0.5, 1.0])
    np.testing.assert_allclose(track.at(np.array([0.5]))[0], expected, atol=1e-9)


@pytest.mark.parametrize("base", ["base", "mast", "other", "lidar"])
def test_the_mount_of_a_sensor_goes_over_the_common_ancestor(base):
    rng = np.random.default_rng(3)
    steps = {name: random_pose(rng) for name in ("mast", "lidar", "other")}
    tree = FrameTree()
    for parent, child in (("base", "mast"), ("mast", "lidar"), ("base", "other")):
        tree.add(vector(transforms=[link(parent, child, steps[child])]), static=True)
    mast, lidar, other = (matrix(steps[name]) for name in ("mast", "lidar", "other"))
    expected = {
        "base": mast @ lidar,
        "mast": lidar,
        "other": np.linalg.inv(other) @ mast @ lidar,
        "lidar": np.eye(4),
    }
    np.testing.assert_allclose(tree.mount(base, "lidar"), expected[base], atol=1e-9)
    assert tree.mount("elsewhere", "lidar") is None


def test_a_sensor_that_turns_on_the_base_has_no_mount():
    tree = FrameTree()
    tree.add(vector(transforms=[link("base", "lidar", random_pose(np.random.default_rng(0)))]), static=False)
    assert tree.mount("base", "lidar") is None


def test_a_sensor_that_hangs_on_nothing_has_no_poses():
    tree = FrameTree()
    tree.add(vector(transforms=[link("base", "lidar", random_pose(np.random.default_rng(0)))]), static=True)
    assert tree.track("lidar", 0, np.zeros(3)) is None
