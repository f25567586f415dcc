"""The second simulator: its ground, its model and its summary."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from known_grounds import PlaneGround, SineGround

from bumpymap.lab.simulate.terrain import Strip
from bumpymap.rating.vehicle_profile import load_profile

pytestmark = pytest.mark.slow
WARTHOG = load_profile("warthog")


@pytest.fixture
def second(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(Path(__file__).parent), *sys.path])
    import second_simulator

    return second_simulator


@pytest.fixture
def vehicle_module(second):
    return sys.modules[second.MujocoVehicle.__module__]


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.5, -1.2])
def test_field_holds_the_strip_and_its_nodes_are_those_of_the_ground(vehicle_module, heading):
    ground = SineGround(0.05, 2.0)
    strip = Strip(3.05, -1.3, heading, 11.0, 2.8)
    field = vehicle_module.field_under(ground, strip)
    rows, cols = field.heights.shape
    east = field.middle[0] + (np.arange(cols) - (cols - 1) / 2) * 0.1
    north = field.middle[1] + (np.arange(rows) - (rows - 1) / 2) * 0.1
    end = strip.easting + strip.length * math.cos(heading), strip.northing + strip.length * math.sin(heading)
    for place, axis in ((strip.easting, east), (end[0], east), (strip.northing, north), (end[1], north)):
        assert axis[0] <= place - strip.half_width + 1e-9
        assert axis[-1] >= place + strip.half_width - 1e-9
    np.testing.assert_allclose(field.heights[rows // 2], ground.height(east, 0 * east), atol=1e-9)


def test_summary_tells_how_far_two_simulations_differ(second):
    rng = np.random.default_rng(1)
    one = np.exp(rng.uniform(-4, -1, 4000))
    other = one * np.exp(rng.normal(0.05, 0.1, 4000))
    failed = np.where(np.arange(4000) < 100, 0.5, 0.0)
    always = {"kind": "flat", "first_error": 0.0, "first_failed": 0.0}
    records = [
        always | {"index": i, "first": a, "second": b, "second_failed": c}
        for i, (a, b, c) in enumerate(zip(one.tolist(), other.tolist(), failed.tolist(), strict=True))
    ]
    found = second.summary(records, {("flat", i): (a * math.exp(0.05), 0.1, 0.1) for i, a in enumerate(one.tolist())})
    assert found["terrains"] == 3900
    assert found["median_ratio"] == pytest.approx(math.exp(0.05), rel=0.01)
    assert found["log_rms"] == pytest.approx(math.hypot(0.05, 0.1), rel=0.05)
    assert found["held"] == pytest.approx(0.8, abs=0.02)
    assert second.summary(records[:50], {}) == {"terrains": 0}


@pytest.mark.parametrize("setup", ["usual", "sphere", "cylinder"])
def test_vehicle_rests_on_its_wheels(second, setup):
    pytest.importorskip("mujoco")
    vehicle = second.MujocoVehicle(
        WARTHOG, PlaneGround((0.0, 0.0)), Strip(1.0, 2.0, 0.8, 1.0, 2.0), second.SETUPS[setup]
    )
    vehicle.command(0.0, 0.0)
    vehicle.advance(1000)
    pose = vehicle.pose()
    assert (pose.easting, pose.northing, pose.heading) == pytest.approx((1.0, 2.0, 0.8), abs=0.01)
    assert pose.tilt < 0.005
    assert abs(pose.pitch_rate) < 1e-3


def test_level_ground_is_crossed_smoothly(second):
    pytest.importorskip("mujoco")
    drives = second.drive_terrain(WARTHOG, np.zeros((15, 15)), [1], second.SETUPS["usual"])
    assert drives.outcome == ("completed",)
    assert drives.mean_c_r < 0.003
