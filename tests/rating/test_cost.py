"""What bars a tile and what others cost: the paper's rule, textures, the floor of C_r, steps, ways through mosaics."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cost_maps import patch_stack
from hypothesis import given, strategies as st
from scenes import PIXELS, TILE_SIZE, Wall, crossed, mosaic
from scipy import ndimage
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.special import ndtr
from scipy.stats import binned_statistic_2d

from bumpymap.core import FREE, NO_CLASS, UNDECIDED, UNSEEN, BadInputError, CostRule, FeatureSettings, UsageError, loops
from bumpymap.core.types import CANOPY, OBSTACLE, TEXTURES, Barred, Georeference, Reason, VehicleBody
from bumpymap.lab.simulate.ride_fit import survey_terrains
from bumpymap.lab.terrains import make_terrain, make_textures
from bumpymap.patches.features import measure
from bumpymap.rating import THIN_COLUMNS, Calibration, RideModel, find_calibration, rate_as_paper, rate_beside_steps
from bumpymap.rating.passable import close_split_tiles, find_passable, free_areas, settle_objects
from bumpymap.rating.steps import STEP_COLUMNS, apply_steps, closing_height, crossing_fails, edge_usable, find_steps
from bumpymap.rating.textures import PAPER_TABLE, TextureModel, classify, rate
from bumpymap.rating.vehicle_profile import Floor, Vehicle, with_floor
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


NORTH, EAST, SOUTH, WEST = range(4)
RNG = np.random.default_rng(7)
PLACES = [(*RNG.uniform(4.5, 7.5, 2), RNG.uniform(0, 360)) for _ in range(25)]


def highest(steps):
    return np.fmax(steps.inner, steps.edge_step)


@pytest.mark.parametrize("height", [0.05, -0.4, 2.0])
def test_a_wall_at_any_place_and_angle_is_measured_in_full(height):
    for place in PLACES:
        wall = Wall(height, *place)
        tiles = crossed(wall, 4)
        assert tiles.any()
        found = highest(find_steps(mosaic(wall, 4), PIXELS))
        np.testing.assert_allclose(found[tiles], abs(height), rtol=0.05)


@pytest.mark.parametrize("shift", [-0.1, 0.0, 0.04])
def test_a_wall_on_or_next_to_a_border_belongs_to_both_tiles(shift):
    """The second of four columns ends at 6 m; a wall up to half a pixel beside it is a step between both tiles."""
    steps = find_steps(mosaic(Wall(0.5, 6 + shift, 0, 0), 4), PIXELS)
    np.testing.assert_allclose(steps.border[:, 0, EAST], 0.5, rtol=1e-5)
    np.testing.assert_allclose(steps.border[:, 1, WEST], 0.5, rtol=1e-5)
    assert (steps.border[..., [NORTH, SOUTH]] < 1e-6).all()
    np.testing.assert_allclose(steps.unseen, 0.5, rtol=1e-5)
    sloping = find_steps(mosaic(Wall(0.3, 6 + shift, 6, 12, (0.3, -0.2)), 4), PIXELS)
    np.testing.assert_allclose(sloping.border[:, 0, EAST], 0.3, rtol=0.05)


@pytest.mark.parametrize("offset", [0.9, 1.5, 2.1])
def test_a_wall_well_inside_a_tile_is_left_to_its_rating(offset):
    steps = find_steps(mosaic(Wall(0.5, 3 + offset, 0, 0), 4), PIXELS)
    np.testing.assert_allclose(steps.inner[:, 0], 0.5, rtol=1e-5)
    assert (steps.unseen < 1e-6).all()


def test_without_a_neighbour_the_step_is_unknown():
    heights = mosaic(Wall(0.3, 4.5, 6, 0), 3)
    heights[:, 2 * PIXELS :] = np.nan
    steps = find_steps(heights, PIXELS)
    assert np.isnan(steps.border[0, 0, EAST])
    assert np.isfinite(steps.border[0, 0, [NORTH, SOUTH, WEST]]).all()
    assert steps.inner[0, 0] == pytest.approx(0.3, rel=1e-5)
    empty = find_steps(np.full_like(heights, np.nan), PIXELS)
    assert np.isnan(empty.border).all()
    assert np.isnan(empty.unseen).all()


def test_what_stands_on_the_ground_makes_no_step_and_hides_none_beside_it():
    """A thin wall in one tile, and a bank 3 m beside it in the next."""
    heights = mosaic(Wall(0.4, 7.5, 0, 0), 4)
    standing = np.zeros(heights.shape, bool)
    standing[:, PIXELS + 5 : PIXELS + 7] = True
    walled = np.where(standing, heights + 2.0, heights)
    bare, seen, left = (
        find_steps(*given) for given in ((heights, PIXELS), (walled, PIXELS), (walled, PIXELS, 3.0, np.inf, standing))
    )
    assert (highest(seen)[:, 0] > 1.5).all()
    assert (np.nan_to_num(highest(left)) <= highest(bare)).all()
    assert (np.nan_to_num(highest(left))[:, 0] < 0.01).all()
    np.testing.assert_array_equal(left.inner[:, 1], bare.inner[:, 1])
    assert (left.inner[:, 1] > 0.3).all()


@pytest.mark.parametrize("noise", [0.005, 0.03])
def test_noise_has_no_steps_and_a_kerb_stands_out_from_it(noise):
    """Eight times as high as the noise of a pixel is enough."""
    rng = np.random.default_rng(3)
    found = highest(find_steps(rng.normal(0, noise, (16 * PIXELS, 16 * PIXELS)), PIXELS))
    assert (found > 0).mean() < 0.02
    assert (found > 3 * noise).mean() < 0.005
    heights = mosaic(Wall(8 * noise, 6.02, 6, 3), 4)
    kerb = find_steps(heights + rng.normal(0, noise, heights.shape), PIXELS)
    np.testing.assert_allclose(kerb.border[:, 0, EAST], 8 * noise, rtol=0.25)


@pytest.mark.parametrize(("density", "noise"), [(10, 0.003), (10, 0.05), (25, 0.05), (100, 0.02)])
def test_the_line_of_a_step_is_closed_whole_and_nothing_else(density, noise):
    """A step of 0.5 m at three headings; a kerb, a ramp of 20 degrees and a ditch of 0.3 m are no lines."""
    closing, found = closing_height(SHIPPED), []
    for turn in (0, 18, 63):
        wall = Wall(0.5, 12.1, 12.3, turn)
        steps = find_steps(points_of(wall.ground, density, noise, turn), PIXELS, 3.0, closing)
        x, y = np.meshgrid(MIDDLES, MIDDLES[::-1])
        away = np.abs(wall.distance(x, y))
        assert not steps.closed[away > 0.8].any()
        along = (x - 12.1) * -np.sin(np.radians(turn)) + (y - 12.3) * np.cos(np.radians(turn))
        parts = np.floor(along / 0.8)[steps.closed]
        found += [part in parts for part in range(-8, 8)]
        for ground in (
            Wall(0.15, 12.1, 12.3, turn).ground,
            lambda x, y, wall=wall: np.clip(wall.distance(x, y) * np.tan(np.radians(20)), 0, 1),
            lambda x, y, wall=wall: np.where(np.abs(wall.distance(x, y)) < 0.15, -1.0, 0.0),
        ):
            closed = find_steps(points_of(ground, density, noise, turn), PIXELS, 3.0, closing).closed
            assert closed.mean() < 1e-3
    assert np.mean(found) > 0.93


MIDDLES = (np.arange(8 * PIXELS) + 0.5) * TILE_SIZE / PIXELS


def points_of(ground, density, noise, seed):
    """Return 8 x 8 tiles of ground, a function of x and y, from points at random places; NaN in empty pixels."""
    rng = np.random.default_rng(seed)
    n = 8 * PIXELS
    x, y = rng.uniform(0, 8 * TILE_SIZE, (2, int(density * (8 * TILE_SIZE) ** 2)))
    z = ground(x, y) + rng.normal(0, noise, len(x))
    return binned_statistic_2d(8 * TILE_SIZE - y, x, z, "mean", n, [(0, 8 * TILE_SIZE)] * 2).statistic


def near(wall):
    """Tiles of the inner 6 x 6 whose middle is within 1 m of a wall."""
    axis = (np.arange(1, 7) + 0.5) * TILE_SIZE
    return np.abs(wall.distance(*np.meshgrid(axis, axis[::-1]))) < 1


def share_with_step(rise, width, density):
    """Share of the tiles across a ridge or ditch in level ground where most of its height is a step."""
    share = []
    for number, place in enumerate(PLACES[:12]):
        wall = Wall(rise, 6 + place[0], 6 + place[1], place[2])
        heights = points_of(lambda x, y, w=wall: rise * (np.abs(w.distance(x, y)) < width / 2), density, 0.01, number)
        share.extend(highest(find_steps(heights, PIXELS))[near(wall)] > 0.7 * abs(rise))
    return np.mean(share)


@pytest.mark.parametrize("density", [100, 20, 10])
@pytest.mark.parametrize(("width", "least"), [(0.2, 0.4), (0.3, 0.9), (0.5, 0.9), (0.8, 0.65)])
def test_a_ridge_is_a_step_however_narrow(density, width, least):
    """A wheel rolls over a narrow ditch, not over a narrow wall; in pixels of 0.2 m, one of 0.3 m stands in full."""
    assert share_with_step(0.5, width, density) > least


def test_few_points_make_no_steps_of_rough_ground():
    """Lumps of half a metre: a copy with a tenth of the points has hardly a step more than the dense survey."""
    rng = np.random.default_rng(8)
    waves = rng.uniform(-4, 4, (2, 60)), rng.uniform(0, 2 * np.pi, 60)

    def lumps(x, y):
        return 0.07 * np.cos(x[:, None] * waves[0][0] + y[:, None] * waves[0][1] + waves[1]).sum(axis=1)

    dense, thin = (highest(find_steps(points_of(lumps, density, 0.01, 1), PIXELS)) > 0.35 for density in (100, 10))
    assert thin[~dense].mean() < 0.1


def smooth(n):
    """Columns of n smooth tiles."""
    values = {"class_id": 0, "c_r": 0.02, "c_r_low": 0.01, "c_r_high": 0.03, "p_fail": 0.001, "confidence": 0.9}
    columns = {name: np.full(n, value, np.float32) for name, value in values.items()}
    return columns | {"class_id": np.zeros(n, np.uint8), "coverage": np.ones(n)}


def test_higher_steps_are_never_better():
    step = np.linspace(0, 3, 400)
    felt = apply_steps(smooth(400), step, SHIPPED)
    for name in ("class_id", "c_r", "c_r_low", "c_r_high", "p_fail"):
        assert (np.diff(felt[name].astype(float)) >= 0).all(), name
    assert felt["class_id"][0] == 0
    assert felt["class_id"][-1] == 3
    assert felt["p_fail"][-1] > 0.9
    assert (felt["c_r_low"] <= felt["c_r"]).all()
    assert (felt["c_r"] <= felt["c_r_high"]).all()
    assert ((felt["confidence"] > 0) & (felt["confidence"] <= 1)).all()
    fails = crossing_fails(step, SHIPPED)
    assert (np.diff(fails) >= 0).all()
    assert fails[0] == 0
    assert fails[-1] == 1


def test_tiles_without_a_step_unknown_ones_and_those_that_are_rougher_keep_their_bits():
    columns = smooth(5)
    columns["class_id"][2:] = 3, 3, 255
    for name in STEP_COLUMNS[1:]:
        columns[name][2:] = 0.99 if name in {"p_fail", "confidence"} else 5.0
        columns[name][4] = np.nan
    felt = apply_steps(columns, np.array([0, np.nan, 0.2, 0.1, 1.0]), SHIPPED)
    for name in STEP_COLUMNS:
        np.testing.assert_array_equal(felt[name], columns[name])
        assert felt[name].dtype == columns[name].dtype


def test_a_border_is_usable_if_it_is_known_and_low():
    border = np.array([[0.0, 0.05, 2.0, np.nan]])
    np.testing.assert_array_equal(edge_usable(border, SHIPPED), [[True, True, False, False]])
    assert np.isnan(crossing_fails(border, SHIPPED)[0, 3])


@pytest.mark.parametrize("damage", [{"tile": {}}, {"crossing": {"height": [1, 0.5]}}, {"tile": 3}])
def test_a_damaged_record_is_named(damage):
    broken = replace(SHIPPED, steps={**SHIPPED.steps, **damage})
    with pytest.raises(BadInputError, match="record of steps"):
        edge_usable(np.zeros(1), broken)


def test_pixels_that_close_are_those_of_filters_over_the_mosaic():
    tiles, pixels = 4, 10
    shape, seen = (tiles * pixels, tiles * pixels), RNG.random((tiles * pixels, tiles * pixels)) < 0.7
    heights = np.where(seen, RNG.normal(0, 0.2, shape), np.nan).astype(np.float32)
    is_thin, least = RNG.random((tiles, tiles)) < 0.5, RNG.uniform(0.3, 0.9, (tiles, tiles))
    of_tiles = np.ones((pixels, pixels))
    low, closed = np.empty(shape, bool), np.empty(shape, bool)
    loops.find_low(heights, pixels, least, low)
    highest = ndimage.maximum_filter(np.where(seen, heights, -np.inf), 3, mode="nearest")
    np.testing.assert_array_equal(low, highest - heights >= np.kron(least, of_tiles))

    across, along = RNG.choice(3, (2, *shape), p=(0.95, 0.03, 0.02)).astype(np.uint8)
    jumps = RNG.random(shape) < 0.01
    loops.close_steps(across, np.ascontiguousarray(along.T), pixels, is_thin, jumps, low, closed)
    sure = np.kron(is_thin, of_tiles) > 0
    steps = np.maximum(across, along) > sure
    beside = ndimage.correlate((steps | jumps | low).astype(int), np.ones((5, 5), int), mode="constant")
    assert (steps & sure & (beside == 1)).any()
    np.testing.assert_array_equal(closed, jumps | (steps & (~sure | (beside > 1))))


ROWS, COLS = np.indices((PIXELS, PIXELS))
NOTHING = np.zeros((1, PIXELS, PIXELS), bool)
WORST = np.array([0.9], np.float32), np.array([1.0], np.float32)


def rated(heights, line, noise=0.0):
    rng = np.random.default_rng(3)
    thin = np.full((1, len(THIN_COLUMNS)), np.nan, np.float32)
    own = {"points": 225.0, "squares": 2.0 * noise**2 * 500, "pairs": 500.0}
    thin[0, [THIN_COLUMNS.index(name) for name in own]] = list(own.values())
    noisy = (heights + rng.normal(0, noise, heights.shape))[None].astype(np.float32)
    return rate_beside_steps(noisy, line[None], NOTHING, WORST, thin, SHIPPED)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_beside_a_drop_the_ground_is_as_good_as_it_is(noise, slope):
    heights = np.where(COLS < 3, -1.2, 0.0) + slope * 0.2 * ROWS
    closed, c_r, p_fail = rated(heights, COLS == 2, noise)
    assert not closed.any()
    assert p_fail[0] < 0.1
    assert c_r[0] < (0.03 if noise == 0.0 else 0.1)


def test_what_is_too_steep_or_fails_stays_closed():
    steep = rated(np.where(COLS < 3, -1.2, 0.0) + 0.2 * np.tan(np.radians(40)) * ROWS, COLS == 2)
    blocks = np.where(COLS < 3, -1.2, 0.5 * ((ROWS // 3 + COLS // 3) % 2))
    failing = rated(blocks, COLS == 2)
    for closed, c_r, p_fail in (steep, failing):
        assert closed[0, :, 6:].all()
        assert np.isnan([c_r[0], p_fail[0]]).all()


def test_the_larger_of_two_rests_is_open_and_the_ditch_is_not_asked_for():
    """A ditch of 1 m, of whose floor 0.2 m lie apart from its sides: nothing can stand there."""
    heights = np.where((COLS > 3) & (COLS < 9), -1.0, 0.0)
    closed, _, p_fail = rated(heights, (COLS == 3) | (COLS == 9))
    assert closed[0, :, 6].all()
    assert not closed[0, :, 14].any()
    assert p_fail[0] < 0.1


def test_the_nearest_mark_is_that_of_a_distance_transform():
    marks = np.random.default_rng(5).random((40, PIXELS, PIXELS)) < np.linspace(0.01, 0.5, 40)[:, None, None]
    marks = np.concatenate([marks[marks.any(axis=(1, 2))], NOTHING])
    place, square = (np.empty(marks.shape, np.int32) for _ in range(2))
    loops.find_nearest(marks, place, square)
    for tile, own, far in zip(marks[:-1], place, square, strict=False):
        distance, (row, col) = distance_transform_edt(~tile, return_indices=True)
        np.testing.assert_array_equal(own, PIXELS * row + col)
        np.testing.assert_allclose(np.sqrt(far), distance)
    assert (place[-1] == -1).all()


BODY = VehicleBody(clearance_m=0.25, height_m=1.4, width_m=1.0, brush_stem_m=0.25)  # with margins 1.2 m: 6 pixels


def judged(inner, *, edges=None, known=True, too_steep=False, fails=False, ring=FREE, body=BODY):
    """What bars the tiles of ``inner`` (pixels), with a ring of tiles of one state."""
    tiles = len(inner) // PIXELS
    objects = np.pad(inner, PIXELS, constant_values=ring)
    alone = np.broadcast_to(barred_alone(known, too_steep, fails), (tiles, tiles))
    usable = np.ones((tiles, tiles, 4), bool) if edges is None else edges
    return find_passable(objects, alone, usable, body, 3.0)


def barred_alone(known, too_steep, fails):
    reasons = [Barred.UNKNOWN, Barred.SLOPE, Barred.FAILS]
    return np.select([np.logical_not(known), too_steep, fails], reasons, Barred.NO).astype(np.uint8)


def free(tiles=1):
    return np.full((tiles * PIXELS, tiles * PIXELS), FREE, np.uint8)


def only(found):
    assert found.shape == (1, 1)
    assert found.dtype == np.uint8
    return Barred(int(found[0, 0]))


def test_obstacles_and_missing_tiles_around_count():
    # A wall in the neighbouring tiles, all around: the middle keeps 0.6 m from it, and reaches no side.
    for ring, reason in ((OBSTACLE, Barred.OBSTACLE), (UNSEEN, Barred.LITTLE_SEEN)):
        assert only(judged(free(), ring=ring)) == reason
        inner = judged(free(3), ring=ring) == Barred.NO
        assert inner.tolist() == [[True] * 3] * 3


def test_the_first_reason_that_holds_is_named():
    wall = np.full_like(free(), OBSTACLE)
    everything = {"known": False, "too_steep": True, "fails": True, "edges": np.zeros((1, 1, 4), bool)}
    order = [Barred.UNKNOWN, Barred.SLOPE, Barred.FAILS, Barred.OBSTACLE, Barred.STEP]
    changes = [{"known": True}, {"too_steep": False}, {"fails": False}]
    for wanted, change in zip(order[:3], changes, strict=True):
        assert only(judged(wall, **everything)) == wanted
        everything |= change
    assert only(judged(wall, **everything)) == Barred.OBSTACLE
    assert only(judged(free(), **everything)) == Barred.STEP


def test_undecided_pixels_need_company_across_the_border():
    objects = free(2)
    objects[3, 14] = objects[4, 15] = UNDECIDED  # neighbours, over the border between two columns of tiles
    objects[9, 14] = UNDECIDED  # alone
    objects[20, 14], objects[21, 15] = UNDECIDED, OBSTACLE
    objects[25, 14] = objects[26, 14] = UNDECIDED  # neighbours in one tile: together still too few
    settled = settle_objects(objects, PIXELS)
    assert np.argwhere(settled == OBSTACLE).tolist() == [[3, 14], [4, 15], [20, 14], [21, 15]]
    assert not np.any(settled == UNDECIDED)


@pytest.mark.parametrize("width", [0.3, 1.0, 1.7, 4.0])
def test_random_obstacles_bar_as_distances_and_regions_tell(width):
    rng = np.random.default_rng(int(10 * width))
    body = replace(BODY, width_m=width)
    inner = rng.choice([FREE, OBSTACLE, UNSEEN, CANOPY], (4 * PIXELS,) * 2, p=[0.97, 0.01, 0.005, 0.015])
    inner = inner.astype(np.uint8)
    usable = rng.random((4, 4, 4)) < 0.7
    found = judged(inner, edges=usable, body=body)
    objects = np.pad(inner, PIXELS, constant_values=FREE)
    radius = (0.5 * width + 0.1) * 5
    bad = np.isin(objects, (OBSTACLE, UNSEEN))
    open_ground = ndimage.distance_transform_edt(~bad) >= radius if bad.any() else ~bad
    near = ndimage.distance_transform_edt(objects != OBSTACLE) < radius
    for row, col in np.ndindex(4, 4):
        part = np.s_[(row + 1) * PIXELS : (row + 2) * PIXELS, (col + 1) * PIXELS : (col + 2) * PIXELS]
        # Over a corner, half the width must be free; a disc as small as a pixel may meet a diagonal line there.
        corners = radius**2 >= 2.0 and radius**2 - 0.5 >= (2.5 * width) ** 2
        regions, number = ndimage.label(open_ground[part], ndimage.generate_binary_structure(2, 1 + corners))
        least = 2 if bad[part].any() else 1
        sides = [{0: regions[0], 1: regions[:, -1], 2: regions[-1], 3: regions[:, 0]}[side] for side in range(4)]
        touched = np.array([[n in side for side in sides] for n in range(1, number + 1)], bool).reshape(-1, 4)
        passes = (touched & usable[row, col]).sum(axis=1) >= least
        blocked = not (touched.sum(axis=1) >= least).any()
        reason = Barred.OBSTACLE if near[part].any() else Barred.LITTLE_SEEN
        assert found[row, col] == (Barred.NO if passes.any() else reason if blocked else Barred.STEP)


def random_mosaic(rng, tiles):
    """Obstacles of all sizes on a mosaic: dots, and thin walls in any direction."""
    side = tiles * PIXELS
    objects = np.full((side, side), FREE, np.uint8)
    objects[rng.random((side, side)) < 0.002] = OBSTACLE
    for _ in range(tiles):
        r, c, angle, length = *rng.uniform(0, side, 2), rng.uniform(0, np.pi), rng.uniform(5, 60)
        along = np.arange(0, length, 0.4)
        row, col = (r + along * np.sin(angle)).astype(int), (c + along * np.cos(angle)).astype(int)
        kept = (row >= 0) & (row < side) & (col >= 0) & (col < side)
        objects[row[kept], col[kept]] = OBSTACLE
    return objects


def passage(objects, by_ground):
    """Barred and areas of the tiles of a mosaic without its two outermost."""
    alone = by_ground[1:-1, 1:-1]
    edges = np.ones((*alone.shape, 4), bool)
    barred = find_passable(objects, alone, edges, BODY, 3.0)
    areas = free_areas(objects, by_ground, barred, BODY, 3.0)
    return close_split_tiles(areas, barred, BODY, 3.0), areas[1:-1, 1:-1], barred


def distances(marked):
    """From the middle of each pixel to that of the nearest marked one, px; those of the tiles two from the rim."""
    inner = slice(2 * PIXELS, -2 * PIXELS)
    return ndimage.distance_transform_edt(~marked)[inner, inner]


@pytest.mark.parametrize("seed", range(12))
def test_steps_between_passable_tiles_are_ways_on_pixels(seed):
    rng = np.random.default_rng(seed)
    tiles = 12
    objects = random_mosaic(rng, tiles)
    by_ground = np.where(rng.random((tiles, tiles)) < 0.1, Barred.FAILS, Barred.NO).astype(np.uint8)
    barred, areas, _ = passage(objects, by_ground)
    free = distances(objects == OBSTACLE) >= 3.0
    ground = distances(np.repeat(np.repeat(by_ground != Barred.NO, PIXELS, 0), PIXELS, 1))
    found = areas.swapaxes(1, 2).reshape(free.shape) > 0
    assert not (found & ~(free & (ground >= 3.0))).any()
    assert found[free & (ground >= 4.0)].all()
    assert (barred == Barred.SPLIT).any()
    # The pieces in which passable tiles hang together lie each in one piece of the ground where the vehicle can be.
    pieces, count = ndimage.label(barred == Barred.NO, np.ones((3, 3)))
    around, _ = ndimage.label(found, np.ones((3, 3)))
    for piece in range(1, count + 1):
        largest = []
        for row, col in np.argwhere(pieces == piece):
            tile = around[row * PIXELS : (row + 1) * PIXELS, col * PIXELS : (col + 1) * PIXELS]
            largest.append(np.bincount(tile[tile > 0]).argmax())
        assert len(set(largest)) == 1


@pytest.mark.parametrize(("width", "walls", "pieces"), [(1.0, (-5, 5), 1), (0.2, (0,), 2)])
def test_pixels_that_touch_at_corners_are_joined_but_not_across_a_diagonal_line(width, walls, pieces):
    """Between two diagonal walls the middle of the vehicle has a diagonal line of pixels; a small one could slip
    through between the pixels of a diagonal wall."""
    objects = free(5)
    row, col = np.indices(objects.shape)
    objects[np.isin(col - row, walls)] = OBSTACLE
    areas = free_areas(
        objects, np.zeros((5, 5), np.uint8), np.zeros((3, 3), np.uint8), replace(BODY, width_m=width), 3.0
    )[1, 1]
    row, col = np.indices(areas.shape)
    between = np.abs(col - row) < 5
    assert len(np.unique(areas[between & (areas > 0)])) == pieces
    if pieces == 1:
        assert (areas[between] > 0).sum() == PIXELS  # a line, which hangs together by its corners alone


def test_areas_are_numbered_by_size_within_each_tile():
    inner = free(5)
    inner[:, 2 * PIXELS + 9] = OBSTACLE  # a wall through the tile in the middle, off its middle
    by_ground = np.zeros((5, 5), np.uint8)
    barred, areas, before = passage(inner, by_ground)
    assert only(areas.max(axis=(2, 3))) == 2
    assert (areas == 1).sum() > (areas == 2).sum() > 0
    assert only(before[1:-1, 1:-1]) == Barred.NO
    assert only(barred) == Barred.SPLIT
