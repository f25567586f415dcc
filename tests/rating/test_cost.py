"""The table and the paper's rule, what bars a tile, the floor of C_r; textures of tiles by any network."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cost_maps import patch_stack
from hypothesis import given, strategies as st
from scipy.ndimage import map_coordinates
from scipy.special import ndtr

from bumpymap.core import BadInputError, FeatureSettings, UsageError
from bumpymap.core.types import NO_CLASS, TEXTURES, Barred, CostRule, Georeference, Reason
from bumpymap.lab.simulate.ride_fit import survey_terrains
from bumpymap.lab.terrains import make_terrain, make_textures
from bumpymap.patches.features import measure
from bumpymap.rating import Calibration, RideModel, Vehicle, apply_steps, find_calibration, rate, with_floor
from bumpymap.rating.steps import STEP_COLUMNS
from bumpymap.rating.textures import PAPER_TABLE, TextureModel, classify, rate_as_paper
from bumpymap.rating.vehicle_profile import Floor
from bumpytiles import Grid

SCALE = {"flat": 0.01, "low_noise": 0.1, "noise_sin": 0.4, "high_noise": 0.8}
LADDER = (0.02, 0.1, 0.5, 2.5)
HERE = Georeference(None)
SHIPPED = Calibration.shipped("warthog")


def calibration(**changes):
    """C_r proportional to z range, by a factor of the texture's own."""
    fields = {
        "z_range": LADDER,
        "c_r": tuple(tuple(SCALE[t] * z for z in LADDER) for t in TEXTURES),
        "c_r_log_sd": ((0.2,) * 4,) * 4,
        "p_fail": ((0.0, 0.0, 0.0, 0.8),) * 4,
        "drives": ((10,) * 4,) * 4,
        "class_limits": (0.02, 0.1, 0.3),
        "class_c_r": (0.01, 0.05, 0.2, 0.6),
    }
    return replace(SHIPPED, **(fields | changes))


def stack(relief, *, slope=0.0, coverage=1.0, reason=Reason.OK, raw_range=None):
    relief = np.array(relief, float)
    z_max = relief if raw_range is None else raw_range
    given = {"slope": slope, "coverage": coverage, "reason": reason, "z_max": z_max}
    columns = {name: np.broadcast_to(value, relief.shape) for name, value in given.items()}
    return patch_stack(len(relief), relief=relief, **columns)


def one_hot(k, n):
    return np.tile(np.eye(4, dtype=np.float32)[k], (n, 1))


@pytest.mark.parametrize("k", range(4))
def test_a_certain_texture_reads_its_own_ladder_log_log(k):
    """Below and above the ladder C_r is proportional to the z range."""
    relief = np.array([0.0, 0.01, 0.02, 0.03, 0.1, 0.2, 0.5, 2.5, 5.0])
    cost = rate(stack(relief), one_hot(k, 9), calibration())
    np.testing.assert_allclose(cost.c_r, SCALE[TEXTURES[k]] * relief, rtol=1e-5, atol=1e-8)


def test_a_spread_that_is_unknown_throughout_still_gives_an_interval():
    unknown = calibration(c_r_log_sd=((None,) * 4,) * 4)
    for k in range(4):
        cost = rate(stack([0.01, 0.1, 5.0]), one_hot(k, 3), unknown)
        assert (cost.c_r_low < cost.c_r).all()
        assert (cost.c_r < cost.c_r_high).all()


def test_ground_that_stops_the_vehicle_is_class_three_whatever_its_c_r():
    failing = rate(stack([2.5]), one_hot(0, 1), calibration())
    assert failing.p_fail[0] == pytest.approx(0.8)
    assert (failing.class_id[0], failing.c_r[0]) == (3, pytest.approx(0.025))
    steep = rate(stack([0.02], slope=31.0), one_hot(0, 1), calibration())
    assert (steep.class_id[0], steep.confidence[0]) == (3, 1.0)
    assert steep.p_fail[0] < 0.5  # that of the drives


def test_beyond_the_last_rung_where_most_arrive_c_r_is_proportional_to_the_z_range():
    table = ((0.0002, 0.001, 0.005, None), (0.002, 0.01, None, None), (0.008, 0.04, 0.2, 1.0), (0.016, 0.08, 0.4, 2.0))
    cost = rate(stack([2.5]), one_hot(1, 1), calibration(c_r=table, p_fail=((0.0, 0.0, 1.0, 1.0),) * 4))
    assert cost.c_r[0] == pytest.approx(0.25)
    assert cost.class_id[0] == 3


def test_probabilities_that_sum_to_a_little_more_than_one_make_no_p_fail_above_one():
    sure_failure = calibration(p_fail=((0.0, 0.0, 0.0, 1.0),) * 4)
    cost = rate(stack([2.5]), np.full((1, 4), np.nextafter(np.float32(0.25), 1)), sure_failure)
    assert cost.p_fail[0] == 1.0


def test_unknown_tiles_stay_unknown():
    patches = stack([0.1, np.nan, 0.1], reason=[Reason.OK, Reason.TOO_MANY_HOLES, Reason.OK])
    probability = np.eye(4, dtype=np.float32)[[3, 3, 3]]
    probability[1] = np.nan
    cost = rate(patches, probability, calibration())
    assert cost.class_id.tolist() == [1, NO_CLASS, 1]
    for name in ("c_r", "c_r_low", "c_r_high", "p_fail", "confidence"):
        assert np.isnan(cost.band(name)).tolist() == [False, True, False]


def test_a_calibration_for_other_tiles_is_refused():
    with pytest.raises(UsageError, match=r"1\.5 m with 30 pixels.*3 m with 15"):
        rate(stack([0.1]), one_hot(0, 1), calibration(tile_size=1.5, pixels=30))


@pytest.mark.parametrize(
    ("texture", "raw_range", "class_id"),
    [
        ("flat", 1.99, 0), ("flat", 2.0, 3),
        ("low_noise", 0.49, 0), ("low_noise", 0.5, 1), ("low_noise", 2.5, 3),
        ("noise_sin", 0.49, 0), ("noise_sin", 0.5, 1), ("noise_sin", 1.0, 2), ("noise_sin", 2.5, 3),
        ("high_noise", 0.0, 1), ("high_noise", 1.5, 2), ("high_noise", 2.0, 3),
    ],
)  # fmt: skip
def test_the_papers_table(texture, raw_range, class_id):
    patches = stack([0.1], raw_range=raw_range)
    cost = rate_as_paper(patches, one_hot(list(PAPER_TABLE).index(texture), 1), calibration())
    assert cost.class_id.tolist() == [class_id]
    assert cost.c_r[0] == pytest.approx(calibration().class_c_r[class_id])


def test_the_paper_calls_thirty_percent_of_holes_and_what_it_cannot_judge_the_roughest():
    patches = stack([0.1, 0.1, np.nan], coverage=[0.7, 0.69, 1.0], reason=[Reason.OK, Reason.OK, Reason.OUTLIER_RELIEF])
    chance = np.eye(4, dtype=np.float32)[[0, 0, 0]]
    chance[2] = np.nan
    assert rate_as_paper(patches, chance, calibration()).class_id.tolist() == [0, 3, 3]


def mixtures(rng, n):
    """Random calibration, probabilities and relief; the mean and spread of ln C_r that follow, (n, 4) each."""
    spread = rng.uniform(0.05, 1.5, (4, 1)) * np.ones(4)
    chance = rng.dirichlet(np.full(4, 0.3), n).astype(np.float32)
    chance[: n // 8] = np.eye(4, dtype=np.float32)[rng.integers(0, 4, n // 8)]
    relief = np.exp(rng.uniform(np.log(0.005), np.log(4.0), n))
    c_r = np.array([[SCALE[t] for t in TEXTURES]]) * relief[:, None]
    mean = np.log(c_r) - 0.5 * spread[:, 0] ** 2
    log_sd = tuple(map(tuple, spread.tolist()))
    return calibration(c_r_log_sd=log_sd, p_fail=((0.0,) * 4,) * 4), chance, relief, mean, spread[:, 0]


def test_quantiles_and_confidence_equal_those_of_scipy():
    cal, chance, relief, mean, sd = mixtures(np.random.default_rng(2), 4000)
    coverage = np.where(relief < 0.5, 0.4, 1.0)
    cost = rate(stack(relief, coverage=coverage), chance, cal)

    def below(log_c):
        return np.sum(chance.astype(float) * ndtr((log_c[:, None] - mean) / sd), axis=1)

    def bisected(share):
        low, high = (mean - 9 * sd).min(axis=1), (mean + 9 * sd).max(axis=1)
        for _ in range(60):
            middle = 0.5 * (low + high)
            left = below(middle) < share
            low, high = np.where(left, middle, low), np.where(left, high, middle)
        return np.exp(low)

    c_r = np.sum(chance * np.exp(mean + 0.5 * sd**2), axis=1)
    np.testing.assert_allclose(cost.c_r, c_r, rtol=1e-6)
    np.testing.assert_allclose(cost.c_r_low, np.minimum(bisected(0.1), c_r), rtol=1e-6)
    np.testing.assert_allclose(cost.c_r_high, np.maximum(bisected(0.9), c_r), rtol=1e-6)
    class_id = np.digitize(c_r, cal.class_limits)
    np.testing.assert_array_equal(cost.class_id, class_id)
    edges = np.log([1e-300, *cal.class_limits, 1e300])
    wanted = coverage * (below(edges[class_id + 1]) - below(edges[class_id]))
    np.testing.assert_allclose(cost.confidence, wanted, rtol=1e-6, atol=1e-6)


RULE = CostRule(ride_weight=5.0, fail_weight=300.0, drive_m=10.0, slope_limit_deg=30.0)


@given(p_fail=st.floats(0, 0.49), drive_m=st.floats(1, 100))
def test_over_the_length_of_a_drive_as_many_arrive_as_the_calibration_says(p_fail, drive_m):
    (hazard,) = replace(RULE, drive_m=drive_m).hazard(np.array([p_fail]))
    assert np.exp(-hazard * drive_m) == pytest.approx(1 - p_fail)
    assert np.exp(-hazard * 3 * drive_m) == pytest.approx((1 - p_fail) ** 3)


def test_a_certain_failure_costs_its_weight_and_one_that_nobody_knows_nothing():
    np.testing.assert_array_equal(RULE.hazard(np.array([0.0, 1.0, np.nan], np.float32)), [0.0, np.inf, np.nan])
    # A hazard of 1/m is one expected failure in a metre: the metre itself, the ride, and fail_weight metres.
    assert RULE.cost(np.array([0.2, 0.2]), np.array([1.0, np.nan])) == pytest.approx([1 + 5 * 0.2 + 300, 1 + 5 * 0.2])


@pytest.mark.parametrize(
    ("tile", "barred"),
    [
        ({}, Barred.NO),
        ({"p_fail": 0.49}, Barred.NO),
        ({"p_fail": 0.5}, Barred.FAILS),
        ({"slope": 30.0}, Barred.NO),
        ({"slope": 30.1, "p_fail": 1.0}, Barred.SLOPE),
        ({"slope": np.nan}, Barred.SLOPE),
        ({"class_id": NO_CLASS}, Barred.UNKNOWN),
        ({"c_r": np.nan}, Barred.UNKNOWN),
        ({"p_fail": np.nan, "class_id": 2}, Barred.NO),
        ({"p_fail": np.nan, "class_id": 3}, Barred.FAILS),
    ],
)
def test_what_bars_a_tile(tile, barred):
    told = {"class_id": 3, "c_r": 0.5, "p_fail": 0.1, "slope": 5.0} | tile
    assert RULE.barred({name: np.array([value]) for name, value in told.items()}).tolist() == [barred]


FLOOR = 0.05
RAISED = replace(SHIPPED, vehicle=SHIPPED.vehicle | {"floor": {"c_r_radpm": FLOOR}})
RATED = ("c_r", "c_r_low", "c_r_high")


@pytest.fixture(scope="module")
def patches():
    kinds = ("flat", "low_noise", "noise_sin", "fractal_5", "fractal_2", "stones", "ruts", "high_noise")
    terrains = [make_terrain(kind, 9, index) for index in (3, 5) for kind in kinds]
    block = next(iter(survey_terrains(terrains, 200.0, 0.005, 1).blocks()))
    return measure(block, FeatureSettings(), ground_only=False)


RATINGS = {"ride": lambda *given: RideModel(given[2]).rate(*given[:2])}
RATINGS |= {"table": rate, "paper": rate_as_paper}


@pytest.mark.parametrize("rating", RATINGS)
def test_every_rating_adds_the_floor_in_power_and_keeps_its_classes(rating, patches):
    """One of zero changes no bit."""
    chance = np.random.default_rng(3).dirichlet(np.ones(4), len(patches.reason))
    textures = chance.astype(np.float32)
    zero = replace(SHIPPED, vehicle=SHIPPED.vehicle | {"floor": {"c_r_radpm": 0.0}})
    bare, same, raised = (RATINGS[rating](patches, textures, calibration) for calibration in (SHIPPED, zero, RAISED))
    assert len(set(bare.class_id.tolist())) >= 3
    for name in ("class_id", "p_fail", "confidence", *RATED):
        before = getattr(bare, name)
        assert getattr(same, name).tobytes() == before.tobytes()
        wanted = np.hypot(before.astype(float), FLOOR) if name in RATED else before
        np.testing.assert_allclose(getattr(raised, name), wanted, rtol=1e-6 if name in RATED else 0)


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


def test_a_floor_is_no_property_of_the_drives(tmp_path):
    """A profile may change it without a new calibration, and a calibration without one loads as before."""
    assert SHIPPED.floor == 0.0
    profile = Vehicle.load("warthog")
    assert SHIPPED.with_preferences(profile, "x") is SHIPPED
    given = SHIPPED.with_preferences(replace(profile, floor=Floor(0.03)), "x")
    assert given.floor == 0.03
    assert given.id != SHIPPED.id
    assert given.with_preferences(profile, "x").floor == 0.0
    path = tmp_path / "mine.json"
    path.write_text(given.to_json())
    assert find_calibration("warthog", path).floor == 0.03


def stack_of(relief, reason=0, grid=None, count=0):
    """Tiles of known relief; no pixel tells its noise, or ``count`` points in it do."""
    relief = np.asarray(relief, np.float32)
    count, reason = np.broadcast_to(count, relief.shape), np.broadcast_to(np.uint8(reason), len(relief))
    spread = {"spread_count": count, "spread_variance": np.where(count > 0, 1e-4 * count, np.nan)}
    return patch_stack(len(relief), grid, relief_map=relief, reason=reason, **spread)


def _textures(per_texture, seed=99):
    rng = np.random.default_rng([seed, 1234])
    return np.concatenate([make_textures(texture, per_texture, rng) for texture in TEXTURES])


@pytest.fixture(scope="module")
def model():
    return TextureModel.shipped()


def seen(measure_points, relief, points, noise, rng):
    """Tiles (n, 15, 15) [m] as points of a density [1/m2] and an error [m] at random places show them."""
    n = len(relief)
    ground = np.concatenate(relief, axis=1)
    x, y = rng.uniform(0, 3 * n, int(points * 9 * n)), rng.uniform(0, 3, int(points * 9 * n))
    row, col = np.clip(14.5 - 5 * y, 0, 14), np.clip(5 * x - 0.5, 0, 15 * n - 1)
    z = map_coordinates(ground, (row, col), order=1) + rng.normal(0, noise, len(x))
    return measure_points(x, y, z)


@pytest.mark.parametrize(("points", "noise"), [(5, 0.02), (10, 0.05), (30, 0.001), (100, 0.005), (400, 0.05)])
def test_level_ground_is_flat_through_any_noise(model, measure_points, points, noise):
    patches = seen(measure_points, np.zeros((60, 15, 15)), points, noise, np.random.default_rng(0))
    judged = patches.reason == Reason.OK
    assert judged.all() or points <= 10, "only few points leave too many holes"
    answer = classify(patches, model)[judged].argmax(axis=1)
    assert np.count_nonzero(answer) <= (0.05 if points > 10 else 0.15) * len(answer)


@pytest.mark.parametrize(("k", "relief"), [(0, 0.2), (1, 0.2), (1, 0.6), (2, 0.6), (2, 1.2), (3, 1.2), (3, 2.5)])
@pytest.mark.parametrize(("points", "noise"), [(20, 0.01), (400, 0.05)])
def test_each_form_at_its_relief_is_told_through_noise(model, measure_points, k, relief, points, noise):
    rng = np.random.default_rng([k, points])
    patches = seen(measure_points, relief * make_textures(TEXTURES[k], 100, rng), points, noise, rng)
    assert (classify(patches, model).argmax(axis=1) == k).mean() > 0.9


@pytest.mark.parametrize(("wavelength", "crossing"), [(0.4, False), (0.6, True), (0.75, False), (0.75, True)])
def test_short_regular_waves_are_never_taken_for_smooth_ground(model, measure_points, wavelength, crossing):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 29.9, (2, 90_000))
    k = 2 * np.pi / wavelength
    for turn in np.linspace(0, np.pi / 2, 5):
        along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
        z = 0.1 * np.sin(k * along) * (np.sin(k * across) if crossing else 1.0) + 0.003 * rng.normal(size=len(x))
        flat = classify(measure_points(x, y, z), model)[:, TEXTURES.index("flat")]
        assert len(flat) == 100
        assert flat.mean() < 0.1
        assert np.quantile(flat, 0.97) < 0.5


def test_ground_without_any_relief_is_flat(model):
    level = np.zeros((3, 15, 15))
    level[1] = 5.0
    level[2] = _textures(1)[3] * 1e-3
    assert classify(stack_of(level), model)[:, 0].min() > 0.95


@pytest.mark.parametrize("grid", [Grid(1.5, 15), Grid(3.0, 30)])
def test_another_grid_is_refused_with_the_remedy(model, grid):
    relief = np.zeros((1, grid.pixels, grid.pixels))
    remedy = f"bumpymap train textures --set tile_size={grid.tile_size:g} --set network.pixels={grid.pixels}"
    with pytest.raises(UsageError, match=f"trained for 3 m with 15(.|\n)*{remedy}"):
        classify(stack_of(relief, grid=grid), model)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": None}, "not a texture network"),
        ({"pixels": None}, "damaged"),
        ({"tile_size": "wide"}, "damaged"),
        ({"classes": '["sand", "mud"]'}, "sand, mud"),
        ({"feature_version": "1"}, "version 1"),
    ],
)
def test_foreign_and_damaged_networks_are_refused(model, tmp_path, changes, message):
    onnx = pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")
    proto = onnx.load_model_from_string(model.content)
    onnx.helper.set_model_props(proto, {key: value for key, value in (model.metadata | changes).items() if value})
    onnx.save_model(proto, tmp_path / "odd.onnx")
    with pytest.raises(BadInputError, match=message) as refusal:
        TextureModel.load(tmp_path / "odd.onnx")
    assert all(words in str(refusal.value) for words in ("odd.onnx", "bumpymap train"))


def test_documentation_states_the_measured_accuracies(model):
    assert len(model.content) < 1_000_000
    root = Path(__file__).resolve().parents[2]
    for page in (root / "docs/pages/textures.md", root / "bumpymap/rating/data/models/textures.md"):
        text = page.read_text(encoding="utf-8")
        assert model.metadata["command"] in text
        for name in ("accuracy_unseen", "accuracy_altered_copies", "accuracy_level", "accuracy_short_waves"):
            assert f"{100 * float(model.metadata[name]):.2f} %" in text, page
