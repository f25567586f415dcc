"""Units and order of times."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from bumpymap.core import BadInputError
from bumpymap.readers.drives.clock import in_order, seconds_of_numbers, sorted_times

FACTORS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
STARTS = st.one_of(st.floats(0.0, 80_000.0), st.floats(1.5e9, 2.0e9))


def told(start, step, unit, kind):
    """Times of 300 samples in a unit, whole numbers but for s; and what is made of them."""
    times = start + np.arange(300) * step
    numbers = times / FACTORS[unit] if unit == "s" else np.round(times / FACTORS[unit]).astype(np.int64)
    return times, seconds_of_numbers(numbers, None, kind, ("a.csv", "t"))


@given(start=STARTS, rate=st.floats(10.0, 800.0), unit=st.sampled_from(list(FACTORS)))
def test_the_unit_of_rates_is_told_for_any_start_and_any_rate(start, rate, unit):
    times, (found, note) = told(start, 1.0 / rate, unit, "rates")
    np.testing.assert_allclose(found, times, atol=6e-4)
    assert (note is None) == (unit == "s")


@given(start=STARTS, rate=st.floats(0.5, 25.0), unit=st.sampled_from(list(FACTORS)))
def test_the_unit_of_positions_is_told_for_any_start_and_any_rate(start, rate, unit):
    times, (found, _) = told(start, 1.0 / rate, unit, "positions")
    np.testing.assert_allclose(found, times, atol=6e-4)


@given(st.lists(st.integers(0, 40), min_size=2, max_size=60))
def test_of_equal_times_the_first_counts_and_order_is_kept(steps):
    time = np.cumsum([0, *steps]).astype(float)
    if np.unique(time).size * 2 < time.size:
        with pytest.raises(BadInputError, match="too coarse"):
            in_order(time, "the rates")
        return
    keep, note = in_order(time, "the rates")
    np.testing.assert_array_equal(time[keep], np.unique(time))
    np.testing.assert_array_equal(keep, np.unique(time, return_index=True)[1])
    assert (note is None) == (len(keep) == len(time))


@given(st.lists(st.floats(0, 100), min_size=1, max_size=50))
def test_messages_are_sorted_and_equal_ones_keep_their_order(times):
    notes = []
    order = sorted_times(np.array(times), "/imu", notes)
    assert order.tolist() == sorted(range(len(times)), key=times.__getitem__)
    assert bool(notes) == (times != sorted(times))
