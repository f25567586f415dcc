"""A floor raises C_r in power and moves no class; without one no bit changes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bumpymap.core import BadInputError, Georeference, TextureMap
from bumpymap.core.config import FeatureSettings
from bumpymap.lab.simulate.ride_fit import survey_terrains
from bumpymap.lab.worlds.terrains import ScanEffects, make_terrain
from bumpymap.patches.features import measure
from bumpymap.rating import RideModel, apply_steps, find_calibration, load_profile, rate, rate_as_paper
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.steps import STEP_COLUMNS
from bumpymap.rating.vehicle_body import floor_of, less_floor, with_floor

SHIPPED = Calibration.shipped("warthog")
FLOOR = 0.05
RAISED = replace(SHIPPED, vehicle=SHIPPED.vehicle | {"floor": {"c_r_radpm": FLOOR}})
HERE = Georeference(None)
RATED = ("c_r", "c_r_low", "c_r_high")


@pytest.fixture(scope="module")
def patches():
    kinds = ("flat", "low_noise", "noise_sin", "fractal_5", "fractal_2", "stones", "ruts", "high_noise")
    terrains = [make_terrain(kind, 9, index) for index in (3, 5) for kind in kinds]
    block = next(iter(survey_terrains(terrains, ScanEffects(200.0, 0.005), 1).blocks()))
    return measure(block, FeatureSettings(), ground_only=False)


@pytest.fixture(scope="module")
def textures(patches):
    chance = np.random.default_rng(3).dirichlet(np.ones(4), len(patches.reason))
    return TextureMap(chance.astype(np.float32))


def by_ride(patches, textures, calibration):
    return RideModel(calibration).rate(patches, textures, HERE)


def by_table(patches, textures, calibration):
    return rate(patches, textures, calibration, HERE)


def as_paper(patches, textures, calibration):
    return rate_as_paper(patches, textures, calibration, HERE)


def test_powers_add_up():
    np.testing.assert_allclose(with_floor(np.array([0.0, 0.03, 0.4]), 0.04), [0.04, 0.05, np.hypot(0.4, 0.04)])
    values = np.geomspace(1e-3, 5, 200)
    np.testing.assert_allclose(less_floor(with_floor(values, 0.032), 0.032), values, rtol=1e-9)
    assert less_floor(np.array([0.01]), 0.032).tolist() == [0.0]


@pytest.mark.parametrize("rating", [by_ride, by_table, as_paper])
def test_every_rating_has_it_and_keeps_its_classes(rating, patches, textures):
    bare, raised = (rating(patches, textures, calibration) for calibration in (SHIPPED, RAISED))
    assert len(set(bare.class_id.tolist())) >= 3
    for name in ("class_id", "p_fail", "confidence"):
        np.testing.assert_array_equal(getattr(raised, name), getattr(bare, name))
    for name in RATED:
        expected = np.hypot(getattr(bare, name).astype(float), FLOOR)
        np.testing.assert_allclose(getattr(raised, name), expected, rtol=1e-6)


@pytest.mark.parametrize("rating", [by_ride, by_table, as_paper])
def test_a_floor_of_zero_changes_no_bit(rating, patches, textures):
    zero = replace(SHIPPED, vehicle=SHIPPED.vehicle | {"floor": {"c_r_radpm": 0.0}})
    bare, same = (rating(patches, textures, calibration) for calibration in (SHIPPED, zero))
    for name in ("class_id", "p_fail", "confidence", *RATED):
        assert getattr(same, name).tobytes() == getattr(bare, name).tobytes()


def test_steps_are_rated_on_top_of_the_ground_alone():
    driven = np.geomspace(0.002, 0.5, 40)
    columns = {name: np.full(40, 0.01, np.float32) for name in STEP_COLUMNS}
    columns |= {"class_id": np.searchsorted(SHIPPED.class_limits, driven, side="right").astype(np.uint8)}
    columns |= {"c_r": driven, "c_r_low": driven / 1.3, "c_r_high": driven * 1.3, "coverage": np.ones(40)}
    raised = columns | {name: with_floor(columns[name], FLOOR) for name in RATED}
    step = np.tile([0.0, np.nan, 0.03, 0.1, 0.4], 8)
    felt, with_it = apply_steps(columns, step, SHIPPED), apply_steps(raised, step, RAISED)
    assert (felt["c_r"] > driven).any()
    for name in STEP_COLUMNS:
        expected = with_floor(felt[name], FLOOR) if name in RATED else felt[name]
        np.testing.assert_allclose(with_it[name], expected, rtol=1e-6)
    still = np.isnan(step) | (step == 0)
    np.testing.assert_array_equal(with_it["c_r"][still], raised["c_r"][still])


def test_it_is_no_property_of_the_drives(tmp_path):
    """A profile may change it without a new calibration, and a calibration without one loads as before."""
    assert floor_of(SHIPPED.vehicle) == SHIPPED.floor == 0.0
    profile = load_profile("warthog").to_dict()
    assert profile["floor"] == {"c_r_radpm": 0.0}
    assert SHIPPED.with_preferences(profile, "x") is SHIPPED
    given = SHIPPED.with_preferences(profile | {"floor": {"c_r_radpm": 0.03}}, "x")
    assert given.floor == 0.03
    assert given.id != SHIPPED.id
    assert given.without_floor().floor == 0.0
    assert given.without_floor().id == SHIPPED.id
    assert given.with_preferences(profile, "x").floor == 0.0
    without = {key: value for key, value in profile.items() if key != "floor"}
    assert given.with_preferences(without, "x").floor == 0.0
    path = tmp_path / "mine.json"
    path.write_text(given.to_json())
    assert find_calibration("warthog", path).floor == 0.03


@pytest.mark.parametrize("value", [-0.1, "much", float("nan")])
def test_a_damaged_one_is_refused(value):
    record = json.loads(SHIPPED.to_json())
    record["vehicle"]["floor"] = {"c_r_radpm": value}
    with pytest.raises(BadInputError, match="damaged calibration"):
        Calibration.from_json(json.dumps(record), "c.json")
