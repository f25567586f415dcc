import pytest
from hypothesis import given, strategies as st

from bumpymap.core import BumpymapError, count_text, join_lines, share_text, shares_text


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        (
            ["the layers in x are complete", "47% of the tiles are unknown"],
            "x are complete. 47% of the tiles are unknown",
        ),
        (
            ["other inputs:", "  a.laz has changed since", "Choose another"],
            "inputs: a.laz has changed since. Choose another",
        ),
        (["there are 2 errors", "  a is 1", "  b is 2", "Mend them"], "errors: a is 1; b is 2. Mend them"),
        (["Is it?", "", "No"], "Is it? No"),
    ],
)
def test_sentences_do_not_run_together(lines, text):
    assert join_lines(lines).endswith(text)
    assert str(BumpymapError(*lines)) == join_lines(lines)


def test_one_is_singular():
    assert [count_text(n, "survey") for n in (0, 1, 1200)] == ["0 surveys", "1 survey", "1,200 surveys"]
    assert count_text(2, "tile has", "tiles have") == "2 tiles have"


@given(st.lists(st.integers(20, 100), min_size=1, max_size=5), st.integers(0, 2))
def test_shares_of_a_whole_make_100_percent(counts, decimals):
    told = [float(text) for text in shares_text(counts, (), decimals, "")]
    assert sum(told) == pytest.approx(100.0, abs=1e-6)
    for share, count in zip(told, counts, strict=True):
        assert abs(share - 100 * count / sum(counts)) < 10.0**-decimals + 1e-6


@pytest.mark.parametrize("counts", [(1, 1, 1), (1255, 785, 745), (125, 375, 500), (495, 495, 10), (0, 0, 7)])
def test_a_share_that_is_told_elsewhere_is_the_same_everywhere(counts):
    told = shares_text(counts, (0, 1))
    assert told[:2] == [share_text(count / sum(counts)) for count in counts[:2]]
    assert sum(int(text.strip("%")) for text in told) == 100


def test_small_shares_are_not_rounded_to_nothing_nor_large_ones_to_all():
    assert shares_text([1, 9999], (), 1) == ["under 0.1%", "over 99.9%"]
    assert shares_text([0, 5]) == ["0%", "100%"]
