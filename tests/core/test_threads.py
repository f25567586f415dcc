"""Work in threads: in order, few at a time, nothing left running."""

import threading

import pytest
from hypothesis import given, settings, strategies as st

from bumpymap.core import in_threads


@pytest.mark.parametrize("threads", [1, 5])
def test_results_come_in_order_whatever_is_finished_first(threads):
    later = threading.Event()

    def work(item):
        if item == 0 and threads > 1:
            assert later.wait(20.0)  # item 1 is done before it
        later.set()
        return 10 * item

    with in_threads(work, range(20), threads) as results:
        assert [result() for result in results] == [10 * item for item in range(20)]


@settings(max_examples=20)
@given(st.integers(1, 6), st.integers(0, 40))
def test_only_a_few_items_are_begun_before_the_first_is_taken(threads, count):
    begun = []

    def items():
        for item in range(count):
            begun.append(item)
            yield item

    taken = 0
    with in_threads(lambda item: item, items(), threads) as results:
        for result in results:
            assert len(begun) <= taken + 2 * threads
            assert result() == taken
            taken += 1
    assert taken == count


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_is_raised_where_its_result_is_taken(threads):
    def work(item):
        if item == 4:
            raise ValueError("four")
        return item

    seen = []
    with in_threads(work, range(8), threads) as results:
        for result in results:
            try:
                seen.append(result())
            except ValueError as error:
                seen.append(str(error))
    assert seen == [0, 1, 2, 3, "four", 5, 6, 7]


@pytest.mark.parametrize("threads", [1, 3])
def test_when_the_body_ends_early_nothing_goes_on(threads):
    begun = []
    before = threading.active_count()

    def take_two():
        with in_threads(begun.append, range(1000), threads) as results:
            for result in results:
                result()
                if len(begun) >= 2:
                    raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        take_two()
    assert len(begun) <= 2 + 2 * threads
    assert threading.active_count() == before
