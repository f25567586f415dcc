import numpy as np
import pytest
from hypothesis import given, strategies as st

from bumpymap.change.compare import hold_false_discoveries, widening

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


def test_widening_is_the_spread_of_what_has_not_changed():
    z = np.random.default_rng(6).standard_normal(20_000)
    assert widening(z) == pytest.approx(1.0, abs=0.03)
    assert widening(0.3 * z) == 1.0
    wide = np.append(2.5 * z, [500.0] * 2_000)
    assert widening(wide) == pytest.approx(2.5, rel=0.15)
    assert widening(np.append(z, np.nan)) == widening(z)
    assert widening(np.full(3, np.nan)) == 1.0
