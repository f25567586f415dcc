"""Recorded drives in DART: standstill, stops, motion that fits itself and the ground."""

import numpy as np
import pytest
from driven_ways import RecordSettings, ReliefGround, Stop, record_way
from sensed_drives import GRAVITY

from bumpymap.rating.vehicle_profile import load_profile

PROFILE = load_profile("warthog")
LINE = np.array([[3.0, 3.0], [8.0, 3.0]])


@pytest.fixture(scope="module")
def recorded():
    """A drive of 5 m over waves of 2 cm, with a stop."""
    pytest.importorskip("dartpy")
    east = (np.arange(60) + 0.5) * 0.2
    ground = ReliefGround.from_heightmap(np.tile(0.02 * np.sin(2 * np.pi * east / 3), (30, 1)), 0.2)
    settings = RecordSettings(stand_before_s=2.0, stand_after_s=1.0, stops=(Stop(2.0, 1.5),))
    return record_way(PROFILE, ground, LINE, settings)


@pytest.mark.slow
class TestInDart:
    def test_it_stands_at_both_ends_and_at_its_stop(self, recorded):
        motion = recorded.motion
        speed = np.linalg.norm(motion.velocity, axis=1)
        assert recorded.result.outcome == "completed"
        assert speed[: round(1.9 * motion.rate_hz)].max() < 0.01
        assert speed[-round(0.5 * motion.rate_hz) :].max() < 0.02
        still = speed < 0.02
        changes = np.flatnonzero(np.diff(still.astype(int)))
        assert len(changes) == 4  # starts, stops, starts again, stops
        stood = (changes[2] - changes[1]) / motion.rate_hz
        assert 1.3 < stood < 2.5
        assert motion.place[changes[1], 0] == pytest.approx(5.5, abs=0.5)

    def test_at_rest_it_feels_gravity(self, recorded):
        felt = recorded.motion.specific_force((0.2, 0.1, 0.3))[200:800]
        assert np.linalg.norm(felt, axis=1) == pytest.approx(GRAVITY, abs=0.02)

    def test_places_attitudes_and_rates_are_of_one_motion(self, recorded):
        motion = recorded.motion
        step = 1 / motion.rate_hz
        moved = np.einsum("nij,nj->ni", motion.rotation, motion.velocity)[1:] * step
        assert np.diff(motion.place, axis=0) == pytest.approx(moved, abs=1e-7)
        # Rotation from sample to sample, in the chassis' axes, is the angular velocity times the step.
        small = np.einsum("nji,njk->nik", motion.rotation[:-1], motion.rotation[1:])
        assert small[:, 0, 2] == pytest.approx(motion.rates[1:, 1] * step, abs=2e-6)

    def test_its_c_r_is_that_of_the_drive_itself(self, recorded):
        time, way, pitched = recorded.motion.sampled
        begin = np.searchsorted(time, 2.0 + 1.5)  # after standing, ramp and cruise; settling is not recorded
        end = begin + round(100 * (recorded.result.seconds - 4.5))
        assert way[end] - way[begin] == pytest.approx(recorded.result.path_m, rel=0.02)
        assert pitched[end] - pitched[begin] == pytest.approx(recorded.result.pitched_rad, rel=0.02)

    def test_wheels_turn_as_fast_as_the_vehicle_drives(self, recorded):
        motion = recorded.motion
        assert motion.wheels.mean(axis=1) == pytest.approx(motion.velocity[:, 0], abs=0.15)
