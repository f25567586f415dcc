"""Text for people and JSON of others: sentences, shares, tables for spreadsheets, URLs without keys, bounded depth."""

import csv

import pytest
from hypothesis import given, strategies as st

from bumpymap.core import share_text, shares_text, write_csv
from bumpymap.core.files import Each, Nullable, Number, parse_json, shape_fault


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


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        ("=cmd|' /C calc'!A0", "'=cmd|' /C calc'!A0"),
        ("+1 north", "'+1 north"),
        (" -x", "' -x"),
        ("\t=1", "\\t=1"),
        ("\uff1d1", "'\uff1d1"),
        ("a\x1b[31m\u202eb\nc\udce9", "a\\x1b[31m\\u202eb\\nc\\xe9"),
        ("quarry, é 道 = 'a'", "quarry, é 道 = 'a'"),
        ("-1.50", "-1.50"),
        (-1.5, "-1.5"),
        (True, "true"),
        (None, ""),
        ("", ""),
    ],
)
def test_cells_are_text_or_numbers_and_no_formulas(tmp_path, value, cell):
    write_csv(tmp_path / "a.csv", ["one", "two"], [[value, 1]])
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.reader(file)) == [["one", "two"], [cell, "1"]]


SHAPE = {"a": Number(0, 9, whole=True), "b?": [str], "c?": (Nullable(Number()),) * 2, "d?": Each({"e": bool})}


@pytest.mark.parametrize(
    ("value", "fault"),
    [
        ({"a": 9, "more": None}, ""),
        ({"a": 1, "b": [], "c": [None, 0.5], "d": {"x": {"e": True}}}, ""),
        ({}, "it is "),
        ({"a": True}, "a is "),
        ({"a": 1, "b": ["x", 2]}, "b.1 is "),
        ({"a": 1, "c": [1, float("nan")]}, "c.1 is "),
        ({"a": 1, "d": {"x": {"e": 1}}}, "d.x.e is "),
    ],
)
def test_the_first_fault_of_a_shape_is_named(value, fault):
    found = shape_fault(value, SHAPE)
    assert found.startswith(fault)
    assert bool(found) == bool(fault)


@pytest.mark.parametrize("depth", [51, 200_000])
@pytest.mark.parametrize(("opening", "closing"), ["[]", ('{"a":', "}")])
def test_what_is_deep_is_refused(depth, opening, closing):
    with pytest.raises(ValueError, match="more than 50 deep"):
        parse_json(opening * depth + "1" + closing * depth)
