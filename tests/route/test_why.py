"""Why a way turns: the straight line against sums by hand, and against a loop over its points."""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from route_maps import write_folder
from route_sites import place, site
from tile_maps import TileMap

from bumpymap.cli import main
from bumpymap.core import Barred
from bumpymap.route.ground import CostGround, sample_line
from bumpymap.route.measure import measure_way
from bumpymap.route.no_way import what_closes
from bumpymap.route.settings import CostSettings
from bumpymap.route.why import measure_straight_line

OPEN, ROUGH = 1.0 + 5.0 * 0.02, 1.0 + 5.0 * 0.4
"""Cost of a metre with a ride weight of 5 m/rad."""


def look(made, *corners):
    made.has_crs, made.to_crs = False, lambda x, y: (x, y)
    ground = CostGround(made, CostSettings(), 10**6)
    stops = np.array([made.at(*corner) for corner in corners])
    return measure_straight_line(ground, stops, measure_way(ground, stops, stops).figures), ground, stops


def field(rows=9, cols=40):
    return np.full((rows, cols), 0.02), np.zeros((rows, cols), np.uint8)


def test_a_wall_a_gap_in_the_map_and_rough_ground_are_told_with_their_lengths():
    c_r, barred = field()
    barred[:, 10:12], barred[:, 12] = Barred.SLOPE, Barred.FAILS
    c_r[:, 20] = 0.4
    made = TileMap(c_r, barred)
    straight, ground, stops = look(made, (4.5, 3.5), (4.5, 30.5))
    points, step = sample_line(stops, made.grid)
    closed = float((~ground.clear_at(points)).sum()) * step  # the wall, and half the vehicle's width before and behind
    assert straight.closed_m == pytest.approx(closed)
    assert 9.0 + 1.5 < closed < 9.0 + 2.1
    assert straight.cost_m == pytest.approx((81.0 - closed - 3.0) * OPEN + 3.0 * ROUGH, rel=1e-5)
    wall, rough = straight.turns
    assert (wall.why, wall.closed_m) == ("too steep, drives fail", pytest.approx(closed))
    assert [wall.easting, wall.northing] == made.at(4.5, 11.5).tolist()
    assert (rough.closed_m, rough.length_m, "C_r 0.400 rad/m, 3.0 m" in rough.why) == (0.0, pytest.approx(3.0), True)
    for said in (f"closed on {closed:.1f} m", "81 m,", "too steep", "rough ground", "crs:480034.50"):
        assert said in straight.words


def test_beyond_the_map_nothing_is_known_and_the_three_longest_are_named():
    c_r, barred = field()
    for number, col in enumerate((5, 11, 18, 26)):
        barred[:, col : col + number + 1] = Barred.STEP
    straight, *_ = look(TileMap(c_r, barred), (4.5, 1.5), (4.5, 35.5))
    assert [round(turn.closed_m) for turn in straight.turns] == [14, 11, 8]
    straight, *_ = look(TileMap(*field()), (4.5, 1.5), (-4.5, 1.5), (-4.5, 5.5), (4.5, 5.5))
    (beyond,) = straight.turns
    assert "no points" in beyond.why


def test_a_stone_on_open_ground_leaves_no_room():
    made = TileMap(*field())
    made.stones.append(tuple(made.at(4.5, 12.5)))
    straight, *_ = look(made, (4.5, 3.5), (4.5, 30.5))
    (turn,) = straight.turns
    assert "no room beside an obstacle" in turn.why
    assert turn.closed_m == pytest.approx(made.vehicle.width_m + 0.2, abs=0.4)


def test_an_open_line_says_what_it_costs_and_a_point_nothing():
    straight, *_ = look(TileMap(*field()), (4.5, 3.5), (4.5, 30.5))
    assert (straight.closed_m, straight.turns) == (0.0, ())
    assert "is open and costs 89 m; the way costs 89 m" in straight.words
    assert look(TileMap(*field()), (4.5, 3.5), (4.5, 3.5))[0].words == ""


def test_the_command_its_files_and_the_page_say_it(tmp_path):
    layers, out = write_folder(tmp_path / "layers", site()), tmp_path / "way"
    words = ["route", str(layers), "--from", place(12.5, 5.5), "--to", place(12.5, 25.5), "--out", str(out)]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    (said,) = [line for line in done.stdout.splitlines() if line.startswith("The straight line, 60 m, is closed")]
    assert "too steep" in said
    straight = json.loads((out / "route.json").read_text())["routes"][0]["straight"]
    assert straight["closed_m"] == pytest.approx(straight["turns"][0]["closed_m"])
    assert math.dist((straight["turns"][0]["x"], 0.0), (float(place(12.5, 15.5).split(",")[0]), 0.0)) < 1e-6
    way = json.loads((out / "route.geojson").read_text())["features"][0]["properties"]
    assert way["why"] == said


def no_way(made, first, last):
    made.has_crs, made.to_crs = False, lambda x, y: (x, y)
    return what_closes(CostGround(made, CostSettings(), 10**6), made.at(*first), made.at(*last))


def test_without_a_way_the_place_where_both_sides_come_closest_is_told():
    c_r, barred = field()
    barred[:, 18:21] = Barred.SLOPE
    said = no_way(TileMap(c_r, barred), (4.5, 3.5), (4.5, 30.5))
    assert "come closest at crs:480058.50" in said
    assert "12 m from tile to tile, where there is: too steep" in said


def test_a_start_between_obstacles_does_not_silence_it():
    c_r, barred = field()
    barred[:, 18:21], barred[3:6, 2:5] = Barred.SLOPE, Barred.SPLIT
    assert "come closest" in no_way(TileMap(c_r, barred), (4.5, 3.5), (4.5, 30.5))
    barred[:, 18:21], barred[:, 10] = Barred.NO, Barred.OBSTACLE
    assert "leave no opening as wide as the vehicle needs, 1.6 m" in no_way(
        TileMap(c_r, barred), (4.5, 3.5), (4.5, 30.5)
    )
