from dataclasses import replace

import numpy as np
import pytest
from walls import Wall, crossed, rated, surveyed

from bumpymap.core import BadInputError
from bumpymap.rating import Calibration, RideModel, apply_steps, crossing_fails, edge_usable
from bumpymap.rating.steps import STEP_COLUMNS

SHIPPED = Calibration.shipped("warthog")
BARE = replace(SHIPPED, steps=None)


def smooth(n):
    """Columns of n smooth tiles."""
    values = {"class_id": 0, "c_r": 0.02, "c_r_low": 0.01, "c_r_high": 0.03, "p_fail": 0.001, "confidence": 0.9}
    columns = {name: np.full(n, value, np.float32) for name, value in values.items()}
    return columns | {"class_id": np.zeros(n, np.uint8), "coverage": np.ones(n)}


@pytest.mark.parametrize("calibration", [SHIPPED, BARE], ids=["driven", "geometric"])
def test_higher_steps_are_never_better(calibration):
    step = np.linspace(0, 3, 400)
    felt = apply_steps(smooth(400), step, calibration)
    for name in ("class_id", "c_r", "c_r_low", "c_r_high", "p_fail"):
        assert (np.diff(felt[name].astype(float)) >= 0).all(), name
    assert felt["class_id"][0] == 0
    assert felt["class_id"][-1] == 3
    assert felt["p_fail"][-1] > 0.9
    assert (felt["c_r_low"] <= felt["c_r"]).all()
    assert (felt["c_r"] <= felt["c_r_high"]).all()
    assert ((felt["confidence"] > 0) & (felt["confidence"] <= 1)).all()
    fails = crossing_fails(step, calibration)
    assert (np.diff(fails) >= 0).all()
    assert fails[0] == 0
    assert fails[-1] == 1


@pytest.mark.parametrize("calibration", [SHIPPED, BARE], ids=["driven", "geometric"])
def test_tiles_without_a_step_and_tiles_that_are_rougher_keep_their_bits(calibration):
    columns = smooth(4)
    columns["class_id"][2:] = 3
    for name in ("c_r", "c_r_low", "c_r_high"):
        columns[name][2:] = 5.0
    columns["p_fail"][2:] = 0.99
    felt = apply_steps(columns, np.array([0, np.nan, 0.2, 0.1]), calibration)
    for name in STEP_COLUMNS:
        np.testing.assert_array_equal(felt[name], columns[name])
        assert felt[name].dtype == columns[name].dtype


def test_unknown_tiles_stay_unknown():
    columns = {name: np.array([np.nan], np.float32) for name in STEP_COLUMNS} | {"coverage": np.zeros(1)}
    columns["class_id"] = np.array([255], np.uint8)
    felt = apply_steps(columns, np.array([1.0]), SHIPPED)
    assert felt["class_id"][0] == 255
    assert all(np.isnan(felt[name][0]) for name in STEP_COLUMNS[1:])


def test_a_border_is_usable_if_it_is_known_and_low():
    border = np.array([[0.0, 0.05, 2.0, np.nan]])
    np.testing.assert_array_equal(edge_usable(border, SHIPPED), [[True, True, False, False]])
    np.testing.assert_array_equal(edge_usable(border, BARE), [[True, True, False, False]])
    assert np.isnan(crossing_fails(border, SHIPPED)[0, 3])


def test_without_drives_the_wheel_decides():
    radius = BARE.vehicle["wheel"]["radius_m"]
    steps = radius * np.array([0.4, 0.7, 0.8, 1.0])
    np.testing.assert_array_equal(edge_usable(steps, BARE), [True, True, False, False])
    np.testing.assert_allclose(crossing_fails(steps, BARE), [0, 0.4, 0.6, 1], atol=1e-6)


@pytest.mark.parametrize("damage", [{"tile": {}}, {"crossing": {"height": [1, 0.5]}}, {"tile": 3}])
def test_a_damaged_record_is_named(damage):
    broken = replace(SHIPPED, steps={**SHIPPED.steps, **damage})
    with pytest.raises(BadInputError, match="record of steps"):
        edge_usable(np.zeros(1), broken)


@pytest.mark.parametrize(("density", "noise"), [(50, 0.005), (400, 0.02)])
@pytest.mark.parametrize(("height", "shift", "turn"), [(1.0, 0.0, 0), (0.2, 0.05, 0), (2.0, -0.1, 90), (0.5, 0.15, 40)])
def test_a_surveyed_wall_is_rated_as_in_the_middle_of_a_tile(height, shift, turn, density, noise):
    model, rng = RideModel(SHIPPED), np.random.default_rng(int(1000 * height))
    wall = Wall(height, 6 + shift, 6 + shift, turn)
    tiles = crossed(wall, 4, 0.05)
    _, felt, _ = rated(surveyed(wall, 4, density, noise, rng), model, 4)
    middle, _, _ = rated(surveyed(Wall(height, 4.5, 4.5, turn), 3, density, noise, rng), model, 3)
    if turn % 90 == 0:  # on or beside a border: both sides of it
        tiles[:] = True
    assert (felt["p_fail"][tiles] > middle["p_fail"][0, 0] - 0.1).all()
    assert (felt["class_id"][tiles] >= middle["class_id"][0, 0]).all()
