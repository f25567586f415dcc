"""The ride of a line and the figures of its road: closed forms, published coefficients, directions, what is unknown."""

import json
import math
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from check_records import stretches_at
from small_surveys import write_survey

import bumpymap
from bumpymap.check.stretches import read_line
from bumpymap.layers import open_map
from bumpymap.rating import Calibration, map_calibration
from bumpymap.route import LineVehicle, RouteConfig, plan_routes

pytestmark = pytest.mark.usefixtures("without_views")

WAVE_M, HEIGHT_M, SIDE_M = 3.0, 0.04, 30.0
WEST, SOUTH = 500_001.0, 4_000_002.0


def across(length=20.0, north=15.0):
    """A line to the east, over the crests of the waves."""
    return [(WEST + 5.0, SOUTH + north), (WEST + 5.0 + length, SOUTH + north)]


def along(length=20.0, east=15.75):
    """A line to the north, along a crest."""
    return [(WEST + east, SOUTH + 5.0), (WEST + east, SOUTH + 5.0 + length)]


@pytest.fixture(scope="module")
def waves(tmp_path_factory):
    """Layers of long even waves that run north, without noise."""
    folder = tmp_path_factory.mktemp("waves")

    def height(x, _):
        return 100.0 + HEIGHT_M * np.sin(2 * np.pi * (x - WEST) / WAVE_M)

    survey = write_survey(folder / "waves.las", points=120_000, side=SIDE_M, height=height)
    return bumpymap.map_survey(survey, folder / "layers")


def test_waves_shake_as_the_closed_form_of_their_drives_says(waves):
    base = 0.92
    expected = 8 * HEIGHT_M * math.sin(math.pi * base / WAVE_M) / (base * WAVE_M)
    ride = bumpymap.ride_along(waves, across(), sigma=0.0)
    c_r, low, high = ride.over(2.0, 18.0)
    assert c_r == pytest.approx(expected, rel=0.15)
    assert low < expected < high
    assert ride.by_line.all()
    assert (ride.seen > 0.9).all()


def test_a_long_line_has_the_ride_of_its_parts(waves):
    there_and_back = [*across(), across()[0]]
    ride = bumpymap.ride_along(waves, [across()[0], *(there_and_back[1:] * 52)])
    assert ride.distance[-1] == pytest.approx(52 * 40.0)
    passes = ride.c_r.reshape(52, 40)
    np.testing.assert_allclose(passes[1:-1], np.broadcast_to(passes[1], (50, 40)), rtol=1e-6)


@pytest.mark.parametrize("length", [0.02, 5.0])
def test_the_ends_of_a_line_are_felt_as_inside_a_longer_one(waves, length):
    short, whole = bumpymap.ride_along(waves, across(length)), bumpymap.ride_along(waves, across())
    inside = bumpymap.ride_along(waves, [(WEST + 2.0, SOUTH + 15.0), across()[1]])
    assert short.over(0.0, length)[0] == pytest.approx(inside.over(3.0, 3.0 + length)[0], rel=0.3)
    assert whole.c_r[0] == pytest.approx(inside.c_r[3], rel=0.02)
    assert whole.a_w[0] == pytest.approx(inside.a_w[3], rel=0.05)
    np.testing.assert_allclose((whole.x[0], whole.y[0]), (WEST + 5.5, SOUTH + 15.0))


def test_the_floor_of_a_vehicle_is_in_the_interval_once(tmp_path):
    survey = write_survey(tmp_path / "flat.las", points=60_000, height=lambda x, _: 100.0 + 0.001 * np.sin(x))
    layers = bumpymap.map_survey(survey, tmp_path / "layers", vehicle="husky")
    ride = bumpymap.ride_along(layers, across(10.0))
    c_r, low, high = ride.over(0.0, 10.0)
    assert c_r == pytest.approx(ride.c_r.mean())
    assert Calibration.shipped("husky").floor <= low < c_r < high


def test_turning_on_an_even_slope_shakes_nobody(tmp_path):
    survey = write_survey(
        tmp_path / "bank.las", points=120_000, side=SIDE_M, height=lambda x, _: 100.0 + 0.3 * (x - WEST)
    )
    layers, turn = bumpymap.map_survey(survey, tmp_path / "layers"), np.linspace(0.0, np.pi / 2, 60)
    arc = np.column_stack([WEST + 5.0 + 15.0 * np.sin(turn), SOUTH + 5.0 + 15.0 * (1.0 - np.cos(turn))])
    assert bumpymap.ride_along(layers, arc).a_w.max() < 0.01


def test_wheels_beside_the_border_of_a_tile_do_not_feel_the_noise_of_the_next(tmp_path):
    layers = bumpymap.map_survey(write_survey(tmp_path / "noisy.las", points=60_000, side=SIDE_M), tmp_path / "layers")
    border, half_track = 3.0 * math.ceil((SOUTH + 12.0) / 3.0) - SOUTH, 0.56
    near, far = (
        bumpymap.ride_along(layers, across(north=border - half_track - beside), sigma=0.0).over(0.0, 20.0)[0]
        for beside in (0.02, 0.7)
    )
    assert near == pytest.approx(far, rel=0.25)


def test_lines_over_noisy_ground_have_the_mean_ride_of_its_tiles_whatever_is_read_with_them(tmp_path):
    rng = np.random.default_rng(1)
    east, north, phase = rng.uniform(-1.0, 1.0, (60, 3, 1)).transpose(1, 0, 2)
    size = 0.003 / (4.0 * np.hypot(east, north) + 0.3)

    def noisy(x, y):
        waves = size * np.sin(4.0 * (east * (x - WEST) + north * (y - SOUTH)) + phase)
        return 100.0 + waves.sum(axis=0) + 0.015 * rng.standard_normal(len(x))

    survey = write_survey(tmp_path / "noisy.las", points=110_000, side=33.0, height=noisy)
    layers = bumpymap.map_survey(survey, tmp_path / "layers")
    places = [(way, place) for way in (across, along) for place in np.arange(6.0, 27.0, 1.4)]
    rides = [bumpymap.ride_along(layers, way(22.0, place), sigma=0.0).over(0.0, 22.0)[0] for way, place in places]
    tiles = bumpymap.open(layers).tiles()
    inner = tiles[tiles["count"] > 800]  # those at the edge of the survey are cut
    assert np.mean(rides) == pytest.approx(inner["c_r"].mean(), rel=0.07)
    alone = bumpymap.ride_along(layers, across(22.0, 16.4), sigma=0.0).c_r
    with_another = bumpymap.ride_along(layers, [*across(22.0, 16.4), *across(22.0, 20.0)[::-1]], sigma=0.0).c_r
    np.testing.assert_allclose(alone[:18], with_another[:18], rtol=1e-6)


def test_the_ride_of_a_metre_does_not_hang_on_how_much_of_the_map_is_read_with_it(tmp_path):
    def posts(x, y):
        return 100.0 + 0.02 * np.sin(9.0 * x) * np.sin(7.0 * y) + (((y - SOUTH) % 3.0 > 2.6) & ((x - WEST) % 3.0 > 2.6))

    survey = write_survey(tmp_path / "posts.las", points=120_000, side=SIDE_M, height=posts)
    layers, (start, end) = bumpymap.map_survey(survey, tmp_path / "layers"), across(north=10.9)
    alone, more = (bumpymap.ride_along(layers, [start, end, *on]) for on in ((), [(end[0], end[1] + 9.0)]))
    np.testing.assert_allclose(alone.c_r[:15], more.c_r[:15], rtol=1e-9)


def test_beyond_the_map_nothing_is_known(waves):
    ride = bumpymap.ride_along(waves, across(length=40.0))
    inside = ride.distance[1:] < 20.0
    assert np.isfinite(ride.c_r[inside]).all()
    assert np.isnan(ride.c_r[ride.distance[:-1] > SIDE_M]).all()
    assert math.isnan(ride.over(30.0, 40.0)[0])
    assert ride.over(0.0, 40.0)[0] == pytest.approx(ride.over(0.0, 26.0)[0], rel=0.1)


def test_an_unsure_place_widens_the_interval_where_it_matters(waves):
    def width(line, sigma):
        _, low, high = bumpymap.ride_along(waves, line, sigma=sigma).over(2.0, 18.0)
        return high / low

    slanting = [(WEST + 5.0, SOUTH + 5.0), (WEST + 8.0, SOUTH + 25.0)]
    assert width(slanting, 1.0) > width(slanting, 0.0)
    assert width(across(), 1.0) == pytest.approx(width(across(), 0.0), rel=0.05)


def test_other_speeds_shake_the_seat_more(waves):
    slow, fast = (bumpymap.ride_along(waves, across(), speed=speed) for speed in (0.5, 1.5))
    assert np.nanmedian(fast.a_w) > 2.0 * np.nanmedian(slow.a_w) > 0.0


@pytest.mark.parametrize("off", [0.0, 1.5])
def test_a_drive_is_held_against_its_own_line_as_far_as_its_positions_are_known(waves, off):
    def of_drive(line):
        """Two stretches of 8 m at 1 m/s, ten samples a second."""
        time, ((x, y), (to_x, to_y)) = np.arange(200) / 10.0, line
        label = np.where(time < 2.0, -1, np.where(time < 18.0, (time >= 10.0).astype(int), -1))
        track = SimpleNamespace(place_sd=lambda at: np.full(len(at), off))
        east, north = (np.interp(time, (0.0, 20.0), ends) for ends in ((x, to_x), (y, to_y)))
        drive = SimpleNamespace(time=time, hertz=10.0, speed=np.ones(200), easting=east, northing=north, track=track)
        two = stretches_at(np.zeros((2, 2)), np.zeros(2), 1.0)
        cut = replace(two, start_s=np.array([2.0, 10.0]), end_s=np.array([10.0, 18.0]), way_m=np.full(2, 8.0))
        return read_line(drive, label, cut, site, vehicle)

    site = open_map(waves)
    vehicle = LineVehicle.of(site, map_calibration(site.manifest, site.grid.tile_size), motion=False)
    slanting = [(WEST + 5.0, SOUTH + 5.0), (WEST + 8.0, SOUTH + 24.8)]
    over, beside = of_drive(across()), of_drive(slanting)
    for line, found in ((across(), over), (slanting, beside)):
        ride = bumpymap.ride_along(waves, line, sigma=max(off, 0.05))
        assert found.c_r == pytest.approx([ride.over(2.0, 10.0)[0], ride.over(10.0, 18.0)[0]], rel=0.1)
        assert (found.c_r_low < found.c_r).all()
    assert (beside.place_sd > 0.1 * beside.c_r).all() == (off > 1.0)
    assert (over.place_sd < 0.1 * over.c_r).all()


@pytest.mark.parametrize(
    ("line", "settings", "message"),
    [
        ([(WEST, SOUTH)], {}, "two points or more"),
        ([(WEST, math.nan), (WEST, SOUTH)], {}, "two points or more"),
        ([(WEST, SOUTH)] * 2, {}, "length is 0"),
        ([(9.1, 48.7), (9.2, 48.7)], {}, "outside the map"),
        ("a line", {}, "are numbers"),
        (across(), {"sigma": -1.0}, "metres from 0 to 5"),
        (across(), {"speed": 40.0}, "holds from"),
    ],
)
def test_senseless_lines_are_refused(waves, line, settings, message):
    with pytest.raises(bumpymap.UsageError, match=message):
        bumpymap.ride_along(waves, line, **settings)


def test_another_calibration_is_refused_and_a_route_does_without(waves, tmp_path):
    other = tmp_path / "husky.json"
    other.write_text(Calibration.shipped("husky").to_json())
    with pytest.raises(bumpymap.BadInputError, match="was made with the calibration"):
        bumpymap.ride_along(waves, across(), calibration=other)
    layers = tmp_path / "layers"
    shutil.copytree(waves, layers)
    manifest = json.loads((layers / "run.json").read_text())
    manifest["calibration"]["id"] = "of-my-own"
    (layers / "run.json").write_text(json.dumps(manifest))
    result = plan_routes(RouteConfig(layers=layers, start="500006,4000017", goal="500026,4000017"))
    assert math.isnan(result.route.figures.c_r_line)
    assert (
        "the ride of the line itself is not known: the map was made with the calibration of-my-own" in result.notes[-1]
    )


def test_a_route_tells_the_ride_of_its_line(waves):
    start, goal = across()
    (way,) = bumpymap.find_routes(waves, start, goal)
    figures = way.figures
    assert figures.c_r_line_low < figures.c_r_line < figures.c_r_line_high
    assert figures.c_r_line > 1.1 * figures.c_r_mean
    assert np.isfinite(way.profile.c_r_line).all()
