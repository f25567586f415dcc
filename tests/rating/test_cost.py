import numpy as np
import pytest
from cost_maps import patch_stack
from scipy.special import ndtr

from bumpymap.core.errors import UsageError
from bumpymap.core.types import NO_CLASS, TEXTURES, Georeference, Reason, TextureMap
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.cost import PAPER_TABLE, rate, rate_as_paper

SCALE = {"flat": 0.01, "low_noise": 0.1, "noise_sin": 0.4, "high_noise": 0.8}
LADDER = (0.02, 0.1, 0.5, 2.5)
HERE = Georeference(None)


def calibration(**changes):
    """C_r proportional to z range, by a factor of the texture's own."""
    fields = {
        "vehicle": {"name": "cart", "ride_weight": 5.0, "slope_limit_deg": 25.0, "speed_mps": 1.0, "track_m": 0.8}
        | {"belly": {"width_m": 0.5, "clearance_m": 0.2}, "wheel": {"radius_m": 0.2, "width_m": 0.1}},
        "tile_size": 3.0,
        "pixels": 15,
        "textures": TEXTURES,
        "z_range": LADDER,
        "c_r": tuple(tuple(SCALE[t] * z for z in LADDER) for t in TEXTURES),
        "c_r_log_sd": ((0.2,) * 4,) * 4,
        "p_fail": ((0.0, 0.0, 0.0, 0.8),) * 4,
        "drives": ((10,) * 4,) * 4,
        "class_limits": (0.02, 0.1, 0.3),
        "class_c_r": (0.01, 0.05, 0.2, 0.6),
    }
    return Calibration(**(fields | changes))


def stack(relief, *, slope=0.0, coverage=1.0, reason=Reason.OK, raw_range=None):
    relief = np.array(relief, float)
    z_max = relief if raw_range is None else raw_range
    given = {"slope": slope, "coverage": coverage, "reason": reason, "z_max": z_max}
    columns = {name: np.broadcast_to(value, relief.shape) for name, value in given.items()}
    return patch_stack(len(relief), relief=relief, **columns)


def textures(*rows):
    return TextureMap(np.array(rows, np.float32))


def one_hot(k, n):
    return TextureMap(np.tile(np.eye(4, dtype=np.float32)[k], (n, 1)))


@pytest.mark.parametrize("k", range(4))
def test_a_certain_texture_reads_its_own_ladder_log_log(k):
    relief = np.array([0.02, 0.03, 0.1, 0.2, 0.5])
    cost = rate(stack(relief), one_hot(k, 5), calibration(), HERE)
    np.testing.assert_allclose(cost.c_r, SCALE[TEXTURES[k]] * relief, rtol=1e-6)


def test_below_the_ladder_c_r_is_proportional_and_above_it_is_kept():
    cost = rate(stack([0.0, 0.01, 2.5, 5.0]), one_hot(3, 4), calibration(), HERE)
    np.testing.assert_allclose(cost.c_r, [0.0, 0.008, 2.0, 2.0], rtol=1e-5, atol=1e-8)
    assert cost.class_id.tolist() == [0, 0, 3, 3]


def test_a_spread_that_is_unknown_throughout_still_gives_an_interval():
    unknown = calibration(c_r_log_sd=((None,) * 4,) * 4)
    for k in range(4):
        cost = rate(stack([0.01, 0.1, 5.0]), one_hot(k, 3), unknown, HERE)
        assert (cost.c_r_low < cost.c_r).all()
        assert (cost.c_r < cost.c_r_high).all()


def test_confidence_falls_with_coverage_and_near_a_limit():
    far = rate(stack([0.06]), one_hot(3, 1), calibration(), HERE).confidence[0]
    near = rate(stack([0.124]), one_hot(3, 1), calibration(), HERE).confidence[0]
    sparse = rate(stack([0.06], coverage=0.4), one_hot(3, 1), calibration(), HERE).confidence[0]
    assert near < 0.6
    assert far > 0.99
    assert sparse == pytest.approx(0.4 * far)


def test_ground_that_stops_the_vehicle_is_class_three_whatever_its_c_r():
    failing = rate(stack([2.5]), one_hot(0, 1), calibration(), HERE)
    assert failing.p_fail[0] == pytest.approx(0.8)
    assert (failing.class_id[0], failing.c_r[0]) == (3, pytest.approx(0.025))
    steep = rate(stack([0.02], slope=26.0), one_hot(0, 1), calibration(), HERE)
    assert (steep.class_id[0], steep.confidence[0]) == (3, 1.0)
    assert steep.p_fail[0] < 0.5  # that of the drives


def test_cells_without_a_completed_drive_take_the_last_that_has_one():
    table = ((0.0002, 0.001, 0.005, None), (0.002, 0.01, None, None), (0.008, 0.04, 0.2, 1.0), (0.016, 0.08, 0.4, 2.0))
    cost = rate(stack([2.5]), one_hot(1, 1), calibration(c_r=table, p_fail=((0.0, 0.0, 1.0, 1.0),) * 4), HERE)
    assert cost.c_r[0] == pytest.approx(0.01)
    assert cost.class_id[0] == 3


def test_unknown_tiles_stay_unknown():
    patches = stack([0.1, np.nan, 0.1], reason=[Reason.OK, Reason.TOO_MANY_HOLES, Reason.OK])
    probability = np.eye(4, dtype=np.float32)[[3, 3, 3]]
    probability[1] = np.nan
    cost = rate(patches, TextureMap(probability), calibration(), HERE)
    assert cost.class_id.tolist() == [1, NO_CLASS, 1]
    for name in ("c_r", "c_r_low", "c_r_high", "p_fail", "confidence"):
        assert np.isnan(cost.band(name)).tolist() == [False, True, False]


def test_a_calibration_for_other_tiles_is_refused():
    with pytest.raises(UsageError, match=r"1\.5 m with 30 pixels.*3 m with 15"):
        rate(stack([0.1]), one_hot(0, 1), calibration(tile_size=1.5, pixels=30), HERE)


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
    cost = rate_as_paper(patches, one_hot(list(PAPER_TABLE).index(texture), 1), calibration(), HERE)
    assert cost.class_id.tolist() == [class_id]
    assert cost.c_r[0] == pytest.approx(calibration().class_c_r[class_id])


def test_the_papers_rule_of_thirty_percent_holes():
    cost = rate_as_paper(stack([0.1, 0.1]), one_hot(0, 2), calibration(), HERE)
    holed = rate_as_paper(stack([0.1, 0.1], coverage=0.69), one_hot(0, 2), calibration(), HERE)
    just = rate_as_paper(stack([0.1, 0.1], coverage=0.7), one_hot(0, 2), calibration(), HERE)
    assert (cost.class_id.tolist(), holed.class_id.tolist(), just.class_id.tolist()) == ([0, 0], [3, 3], [0, 0])


def test_the_paper_calls_what_it_cannot_judge_the_roughest():
    patches = stack([np.nan], reason=Reason.OUTLIER_RELIEF)
    assert rate_as_paper(patches, textures([np.nan] * 4), calibration(), HERE).class_id.tolist() == [3]


def mixtures(rng, n):
    """Random calibration, probabilities and relief; the mean and spread of ln C_r that follow, (n, 4) each."""
    spread = rng.uniform(0.05, 1.5, (4, 1)) * np.ones(4)
    chance = rng.dirichlet(np.full(4, 0.3), n).astype(np.float32)
    chance[: n // 8] = np.eye(4, dtype=np.float32)[rng.integers(0, 4, n // 8)]
    relief = np.exp(rng.uniform(np.log(0.005), np.log(4.0), n))
    c_r = np.array([[SCALE[t] for t in TEXTURES]]) * np.minimum(relief, LADDER[-1])[:, None]
    mean = np.log(c_r) - 0.5 * spread[:, 0] ** 2
    log_sd = tuple(map(tuple, spread.tolist()))
    return calibration(c_r_log_sd=log_sd, p_fail=((0.0,) * 4,) * 4), chance, relief, mean, spread[:, 0]


def test_quantiles_and_confidence_equal_those_of_scipy():
    cal, chance, relief, mean, sd = mixtures(np.random.default_rng(2), 4000)
    cost = rate(stack(relief), TextureMap(chance), cal, HERE)

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
    np.testing.assert_allclose(
        cost.confidence, below(edges[class_id + 1]) - below(edges[class_id]), rtol=1e-6, atol=1e-6
    )


def test_a_tile_is_rated_alike_alone_and_among_others():
    cal, chance, relief, _, _ = mixtures(np.random.default_rng(3), 300)
    whole = rate(stack(relief), TextureMap(chance), cal, HERE)
    for order in (np.arange(300)[::-1], *np.arange(300)[:, None]):
        some = rate(stack(relief[order]), TextureMap(chance[order]), cal, HERE)
        for name in ("c_r", "c_r_low", "c_r_high", "p_fail", "confidence", "class_id"):
            np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[order])


def test_a_ladder_of_one_rung():
    one = calibration(z_range=(0.1,), c_r=tuple((SCALE[t],) for t in TEXTURES), c_r_log_sd=((0.2,),) * 4,
                      p_fail=((0.0,),) * 4, drives=((9,),) * 4)  # fmt: skip
    cost = rate(stack([0.05, 0.1, 0.7]), one_hot(2, 3), one, HERE)
    np.testing.assert_allclose(cost.c_r, [0.2, 0.4, 0.4], rtol=1e-6)
