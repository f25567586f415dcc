"""The vehicle in DART: drives over ground for which the answer is known, at half the time step, in another process."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bumpymap.core.errors import OutputError
from bumpymap.lab.settings import DriveSettings, Physics
from bumpymap.lab.simulate import model
from bumpymap.lab.simulate.drive import Start, draw_start, drive_from
from bumpymap.lab.simulate.model import DartVehicle, PatchGround, Strip
from bumpymap.lab.simulate.motion_fit import drive_motion
from bumpymap.lab.terrains import make_textures
from bumpymap.rating import Vehicle, felt_response

pytest.importorskip("dartpy")

pytestmark = pytest.mark.slow
WARTHOG = Vehicle.load("warthog")
BASE, TRACK, HEIGHT_M = WARTHOG.wheelbase_m, WARTHOG.track_m, 0.01
SHORT, LONG = DriveSettings(measure_s=2.0), DriveSettings(measure_s=5.0)


def wave_ground(amplitude=0.0, wavelength=20.0, gradient=(0.0, 0.0), facets=40):
    """Sine waves along the easting, of so many facets each, on a plane; constant along the northing."""

    def height(easting, northing):
        wave = amplitude * np.sin(2 * np.pi / wavelength * easting)
        return wave + gradient[0] * easting + gradient[1] * northing

    return SimpleNamespace(extent=wavelength, spacing=wavelength / facets, gradient=gradient, height=height)


def slope(degrees):
    return wave_ground(gradient=(math.tan(math.radians(degrees)), 0.0))


def rough_ground(seed, z_range=0.3):
    patch = make_textures("high_noise", 1, np.random.default_rng(seed))[0].astype(np.float64)
    return PatchGround.from_heights(patch * z_range, 3.0)


def test_standing_vehicle_rests_on_its_wheels():
    vehicle = DartVehicle(WARTHOG, slope(0), Strip(1.0, 2.0, 0.8, 1.0, 2.0), Physics())
    vehicle.command(0.0, 0.0)
    vehicle.advance(1000)
    pose, height = vehicle.pose(), vehicle.chassis.getWorldTransform().matrix()[2, 3]
    assert (pose.easting, pose.northing, pose.heading) == pytest.approx((1.0, 2.0, 0.8), abs=1e-3)
    assert (pose.tilt, pose.pitch_rate) == pytest.approx((0, 0), abs=1e-3)
    assert height == pytest.approx(WARTHOG.wheel.radius_m + WARTHOG.chassis.com_height_m, abs=0.005)


def test_a_tyre_spans_a_slot_that_is_narrower():
    def height(_, northing):
        return np.where(
            abs(abs(northing) - 0.55) < 0.08, -0.3, 0.0
        )  # 0.2 m wide between its vertices, under the wheels

    slots = SimpleNamespace(extent=1.0, spacing=0.05, gradient=(0.0, 0.0), height=height)
    vehicle = DartVehicle(WARTHOG, slots, Strip(0.0, 0.0, 0.0, 1.0, 2.0), Physics())
    vehicle.command(0.0, 0.0)
    vehicle.advance(400)
    standing = WARTHOG.wheel.radius_m + WARTHOG.chassis.com_height_m
    assert vehicle.chassis.getWorldTransform().matrix()[2, 3] == pytest.approx(standing, abs=0.009)


def test_temporary_folder_that_is_gone_is_reported_with_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr(model.tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(OutputError, match="TMPDIR"):
        DartVehicle(WARTHOG, slope(0), Strip(0.0, 0.0, 0.0, 1.0, 2.0), Physics())


@pytest.mark.parametrize(("degrees", "heading"), [(0, 145), (30, 0), (30, 90)])
def test_planes_are_crossed_straight_at_the_profiles_speed_and_shake_nothing(degrees, heading):
    made = drive_from(WARTHOG, slope(degrees), Start(0.5, 0.5, math.radians(heading)), SHORT)
    assert made.outcome == "completed"
    along = 1.0 if heading else math.cos(math.radians(degrees))  # progress is horizontal
    assert made.path_m == pytest.approx(2.0 * along, rel=0.02)
    assert made.c_r < 0.001


def test_slope_that_friction_cannot_hold_is_not_climbed():
    made = drive_from(WARTHOG, slope(50), Start(0.0, 0.0, 0.0), SHORT)
    assert made.outcome != "completed"
    assert math.isnan(made.c_r)


@pytest.mark.parametrize(("wavelength", "heading"), [pytest.param(2.5, math.pi, marks=pytest.mark.later), (5.0, 0.0)])
def test_sine_meets_its_closed_form_both_ways(wavelength, heading):
    """Axles W apart pitch by a sine of amplitude ``2 A sin(pi W / L) / W``; a wave adds four times that."""
    made = drive_from(WARTHOG, wave_ground(0.02, wavelength), Start(0.0, 0.0, heading), DriveSettings(measure_s=2.5))
    wanted = 8 * 0.02 * math.sin(math.pi * BASE / wavelength) / (BASE * wavelength)
    assert made.c_r == pytest.approx(wanted, rel=0.05)


def ridge(height):
    """A ridge between the wheels: endless to the east, 0.7 m wide, as high as it is given."""
    axis = (np.arange(15) + 0.5) * 0.2
    profile = height * (np.abs(axis - 1.5) < 0.35)
    return PatchGround(np.repeat(profile[:, None], 15, axis=1), 3.0, 0.0, (0.0, 0.0))


def test_ridge_between_the_wheels_holds_the_belly_that_it_reaches():
    along, brief = Start(0.5, 1.5, 0.0), DriveSettings(settle_s=0.2, ramp_s=0.3, cruise_s=0.0, measure_s=0.5)
    high = replace(WARTHOG, belly=replace(WARTHOG.belly, clearance_m=0.55))
    crossings = ((WARTHOG, 0.22, "completed"), (WARTHOG, 0.45, "stuck"), (high, 0.45, "completed"))
    for vehicle, height, outcome in crossings:
        assert drive_from(vehicle, ridge(height), along, brief).outcome == outcome


@pytest.mark.later
def test_half_the_time_step_changes_little():
    coarse = DriveSettings(measure_s=5.0)
    finer = replace(coarse, physics=replace(coarse.physics, time_step=coarse.physics.time_step / 2))

    def driven(seed, settings):
        ground = rough_ground(seed)
        return drive_from(WARTHOG, ground, draw_start(ground, np.random.default_rng(seed)), settings).c_r

    c_r = [[driven(n, chosen) for chosen in (coarse, finer)] for n in range(6)]
    known = np.array(c_r)[np.isfinite(c_r).all(axis=1)].sum(axis=0)
    assert known[1] == pytest.approx(known[0], rel=0.03)


@pytest.mark.parametrize(
    ("speed", "wavelength", "facets"), [pytest.param(1.0, 0.92, 23, marks=pytest.mark.later), (2.0, 3.0, 50)]
)
def test_waves_lift_as_the_closed_form_says(speed, wavelength, facets):
    ground = wave_ground(HEIGHT_M, wavelength, facets=facets)
    _, a_w = drive_motion(WARTHOG, ground, Start(0.0, 0.0, 0.0), speed, LONG)
    lift = HEIGHT_M * math.cos(math.pi * BASE / wavelength) * felt_response(np.array([speed / wavelength]))[0]
    assert a_w == pytest.approx(abs(lift) / math.sqrt(2), rel=0.05)


def test_waves_at_an_angle_pitch_as_the_closed_form_says():
    turn, wavelength = math.radians(40.0), 3.0
    along, across = math.cos(turn) / wavelength, math.sin(turn) / wavelength
    ground = wave_ground(HEIGHT_M, wavelength, facets=75)
    c_r, _ = drive_motion(WARTHOG, ground, Start(0.0, 0.0, turn), 2.0, LONG)
    pitch = math.sin(math.pi * BASE * along) * math.cos(math.pi * TRACK * across) / BASE
    # A tyre stands on its edge where the ground falls to the side.
    assert c_r == pytest.approx(8 * HEIGHT_M * along * pitch, rel=0.08)


def test_waves_are_hardly_felt_along_their_crests_nor_a_plane_and_a_drive_repeats():
    assert drive_from(WARTHOG, wave_ground(0.05, 2.0), Start(0.5, 0.0, math.pi / 2), SHORT).c_r < 0.005
    plane = wave_ground(gradient=(0.1, 0.0))
    made, again = (drive_motion(WARTHOG, plane, Start(0.0, 0.0, 0.5), 1.0, SHORT) for _ in range(2))
    assert made == again
    assert made[0] < 0.001
    assert made[1] < 0.01
