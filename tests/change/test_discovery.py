import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from bumpymap.change.compare import hold_false_discoveries, two_sided, upper_sided, widening

CHANCES = st.lists(st.one_of(st.floats(0.0, 1.0), st.just(float("nan"))), min_size=0, max_size=40)


def step_up(chances, share):
    """Benjamini and Hochberg by the book: sort, go down from the largest, stop at the first that is low enough."""
    known = sorted(chance for chance in chances if chance == chance)  # noqa: PLR0124 (NaN)
    for place in range(len(known), 0, -1):
        if known[place - 1] <= share * place / len(known):
            return [chance <= known[place - 1] for chance in chances]
    return [False] * len(chances)


@given(CHANCES, st.floats(0.01, 0.5))
def test_the_rule_is_that_of_the_book(chances, share):
    assert hold_false_discoveries(np.array(chances, float), share).tolist() == step_up(chances, share)


def test_the_share_of_false_discoveries_is_held():
    rng = np.random.default_rng(4)
    false, found = 0, 0
    for _ in range(50):
        z = rng.standard_normal(2_000)
        z[:200] += 4.5
        chosen = hold_false_discoveries(two_sided(z), 0.1)
        false, found = false + chosen[200:].sum(), found + chosen.sum()
    assert found > 50 * 150
    assert false / found < 0.1


def test_tails_are_those_of_student():
    z = np.array([-4.0, -1.0, 0.0, 0.5, 3.0, np.nan])
    assert two_sided(z) == pytest.approx(2 * stats.t.sf(np.abs(z), 30), nan_ok=True)
    assert upper_sided(z) == pytest.approx(stats.t.sf(z, 30), nan_ok=True)
    assert two_sided(np.array([3.0]))[0] > 2 * stats.norm.sf(3.0)


def test_widening_is_the_spread_of_what_has_not_changed():
    z = np.random.default_rng(6).standard_normal(20_000)
    assert widening(z) == pytest.approx(1.0, abs=0.03)
    assert widening(0.3 * z) == 1.0
    wide = np.append(2.5 * z, [500.0] * 2_000)
    assert widening(wide) == pytest.approx(2.5, rel=0.15)
    assert widening(np.append(z, np.nan)) == widening(z)
    assert widening(np.full(3, np.nan)) == 1.0
