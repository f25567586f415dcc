"""The vehicle in DART: short drives whose answer is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from known_grounds import PlaneGround, SineGround

from bumpymap.core.errors import OutputError
from bumpymap.lab.simulate import model
from bumpymap.lab.simulate.drive import DriveSettings, Start, drive, drive_from
from bumpymap.lab.simulate.model import (
    DartVehicle,
    Physics,
)
from bumpymap.lab.simulate.terrain import PatchGround, Strip
from bumpymap.rating.textures import make_textures
from bumpymap.rating.vehicle_profile import load_profile

pytest.importorskip("dartpy")

pytestmark = pytest.mark.slow
WARTHOG = load_profile("warthog")
SHORT = DriveSettings(measure_s=2.0)


def rough_ground(z_range, seed=3):
    patch = make_textures("high_noise", 1, np.random.default_rng(seed))[0].astype(np.float64)
    return PatchGround.from_heights(patch * z_range, 3.0)


def test_standing_vehicle_rests_on_its_wheels():
    vehicle = DartVehicle(WARTHOG, PlaneGround((0.0, 0.0)), Strip(1.0, 2.0, 0.8, 1.0, 2.0), Physics())
    vehicle.command(0.0, 0.0)
    vehicle.advance(1000)
    pose, height = vehicle.pose(), vehicle.chassis.getWorldTransform().matrix()[2, 3]
    assert (pose.easting, pose.northing, pose.heading) == pytest.approx((1.0, 2.0, 0.8), abs=1e-3)
    assert pose.tilt < 1e-3
    assert abs(pose.pitch_rate) < 1e-3
    assert height == pytest.approx(WARTHOG.wheel.radius_m + WARTHOG.chassis.com_height_m, abs=0.005)


def test_temporary_folder_that_is_gone_is_reported_with_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr(model.tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(OutputError, match="TMPDIR"):
        DartVehicle(WARTHOG, PlaneGround((0.0, 0.0)), Strip(0.0, 0.0, 0.0, 1.0, 2.0), Physics())


def test_level_ground_is_crossed_straight_at_the_profiles_speed():
    result = drive_from(WARTHOG, PlaneGround((0.0, 0.0)), Start(0.5, 0.5, 2.5), SHORT)
    assert result.outcome == "completed"
    assert result.progress_m == pytest.approx(2.0, rel=2e-3)
    assert result.c_r < 0.001


def test_waves_cost_the_same_both_ways_and_nothing_along_their_crests():
    waves = SineGround(0.05, 2.0)
    there = drive_from(WARTHOG, waves, Start(0.0, 0.0, 0.0), SHORT)
    back = drive_from(WARTHOG, waves, Start(0.0, 0.0, math.pi), SHORT)
    along = drive_from(WARTHOG, waves, Start(0.5, 0.0, math.pi / 2), SHORT)
    assert back.c_r == pytest.approx(there.c_r, rel=0.05)
    assert there.c_r > 0.15
    assert along.c_r < 0.005


def test_slope_that_friction_cannot_hold_is_not_climbed():
    result = drive_from(WARTHOG, PlaneGround((math.tan(math.radians(50)), 0.0)), Start(0.0, 0.0, 0.0), SHORT)
    assert result.outcome != "completed"
    assert math.isnan(result.c_r)


def ridge(height):
    """A ridge between the wheels: endless to the east, 0.7 m wide, as high as it is given."""
    axis = (np.arange(15) + 0.5) * 0.2
    profile = height * (np.abs(axis - 1.5) < 0.35)
    return PatchGround(np.repeat(profile[:, None], 15, axis=1), 3.0, 0.0, (0.0, 0.0))


@pytest.mark.parametrize(("height", "outcome"), [(0.22, "completed"), (0.45, "stuck")])
def test_ridge_between_the_wheels_holds_the_belly_that_it_reaches(height, outcome):
    along, brief = Start(0.5, 1.5, 0.0), DriveSettings(measure_s=1.0)
    assert drive_from(WARTHOG, ridge(height), along, brief).outcome == outcome
    high = replace(WARTHOG, belly=replace(WARTHOG.belly, clearance_m=0.55))
    assert drive_from(high, ridge(height), along, brief).outcome == "completed"


@pytest.mark.later
@pytest.mark.parametrize("name", ["small_rover", "car", "husky"])
def test_other_shipped_vehicles_drive_too(name):
    profile = load_profile(name)
    level = drive_from(profile, PlaneGround((0.0, 0.0)), Start(0.0, 0.0, 0.4), SHORT)
    rough = drive(profile, rough_ground(0.1), 5, SHORT)
    assert level.outcome == rough.outcome == "completed"
    assert level.c_r < 0.001
    assert rough.progress_m > 0.8 * 2.0 * profile.speed_mps
    assert 0.005 < rough.c_r < 1.0
