"""Deskewing against a sensor whose motion is known: what it measures on the way lies where it sees it standing."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bumpymap.core import PoseTrack, Scan
from bumpymap.readers import deskew
from bumpymap.readers.frames.raw import point_seconds, start_of_day_time

SPEED_MPS, TURN_RADPS = 8.0, 1.2


def pose_at(time):
    """Exact pose on a circle, driven at constant speed and turn rate."""
    radius, angle = SPEED_MPS / TURN_RADPS, TURN_RADPS * np.asarray(time)
    places = np.stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), 0.0 * angle], axis=-1)
    return Rotation.from_euler("z", np.atleast_1d(angle)[:, None]), np.atleast_2d(places)


def track(rate=100.0, start=-0.5, end=1.5):
    times = np.arange(start, end, 1.0 / rate)
    turns, places = pose_at(times)
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turns.as_matrix(), places
    return PoseTrack(times, poses)


def spin(first=0.0, seconds=0.1, count=20_000):
    """What a sensor measures of fixed points in one turn, and the same points as it would see them at time 0."""
    world = np.random.default_rng(2).uniform(-60.0, 60.0, (count, 3)) * [1.0, 1.0, 0.05]
    time = np.linspace(first, first + seconds, count).astype(np.float32)
    turns, places = pose_at(time.astype(np.float64))
    turn, place = pose_at(0.0)
    return Scan(turns.inv().apply(world - places).astype(np.float32), time=time), turn.inv().apply(world - place)


@pytest.mark.parametrize("first", [0.0, -0.1, -0.05])
def test_points_are_where_the_sensor_sees_them_at_the_time_of_the_frame(first):
    scan, wanted = spin(first)
    assert np.abs(scan.points - wanted).max() > 0.5
    np.testing.assert_allclose(deskew(scan, track()).points, wanted, atol=1e-3)


def test_without_times_or_poses_nothing_moves():
    scan, _ = spin()
    assert deskew(Scan(scan.points), track()).points is scan.points
    assert deskew(scan, track(start=-3.0, end=-2.0)) is scan
    empty = Scan(np.empty((0, 3), np.float32), time=np.empty(0, np.float32))
    assert deskew(empty, track()) is empty


# ---- units of time ----


@pytest.mark.parametrize("unit", [1.0, 1e6, 1e9])
@pytest.mark.parametrize("start", [0.0, -0.1, 1.6e9, 4321.5])
def test_seconds_microseconds_and_nanoseconds(unit, start):
    exact = np.linspace(0.0, 0.0999, 1000)
    column = (start + exact) * unit
    found = point_seconds(column)
    np.testing.assert_allclose(found, exact + min(start, 0.0), atol=2e-6)
    assert found.dtype == np.float32
    day = start_of_day_time(column)
    assert (day is None) == (start < 1e9)
    assert day is None or abs(day - start) < 1e-5


def test_missing_times_of_beams_without_return():
    column = 1.6e9 + np.linspace(0.0, 0.1, 11)
    column[[0, 5]] = [np.nan, 0.0]
    found = point_seconds(column)
    np.testing.assert_allclose(found[[1, 10]], [0.0, 0.09], atol=1e-6)
    assert np.isnan(found[[0, 5]]).all()


@pytest.mark.parametrize(
    "column", [np.zeros(9), np.arange(3.0) * 1e3, np.array([]), np.array([5.0, 4e12]), np.full(4, np.nan)]
)
def test_times_of_no_clear_unit_are_none(column):
    assert point_seconds(column) is None
    assert start_of_day_time(column) is None
