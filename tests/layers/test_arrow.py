import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, strategies as st

from bumpymap.layers._arrow import lists, numbers, texts, values


@given(st.lists(st.one_of(st.none(), st.text(max_size=5)), max_size=40))
def test_texts_are_what_pyarrow_makes_of_them(parts):
    made = texts(parts, pa.string())
    made.validate(full=True)
    assert made.equals(pa.array(parts, pa.string()))
    assert values(parts, pa.string()).equals(made)


@given(st.lists(st.one_of(st.none(), st.binary(max_size=5)), max_size=40))
def test_bytes_are_what_pyarrow_makes_of_them(parts):
    assert texts(parts, pa.binary()).equals(pa.array(parts, pa.binary()))


@given(st.lists(st.one_of(st.none(), st.integers(-100, 100)), max_size=40))
def test_values_are_what_pyarrow_makes_of_them(given_values):
    for kind in (pa.int8(), pa.int64(), pa.float64()):
        made = values(given_values, kind)
        made.validate(full=True)
        assert made.equals(pa.array(given_values, kind))


@given(st.lists(st.one_of(st.none(), st.booleans()), max_size=40))
def test_truth_values_are_what_pyarrow_makes_of_them(given_values):
    made = values(given_values, pa.bool_())
    made.validate(full=True)
    assert made.equals(pa.array(given_values, pa.bool_()))


@pytest.mark.parametrize("kind", [pa.float32(), pa.float64()])
def test_nan_becomes_null_and_nothing_else_does(kind):
    given_numbers = np.array([0.0, np.nan, -np.inf, 1.5, np.nan, 0.0, 1.0, 2.0, 3.0])
    made = numbers(given_numbers, kind)
    assert made.equals(pa.array(given_numbers, kind, from_pandas=True))
    assert made.null_count == 2


def test_columns_of_a_table_need_not_be_contiguous():
    table = np.arange(12.0, dtype=np.float32).reshape(4, 3)
    assert numbers(table[:, 1], pa.float32()).to_pylist() == [1.0, 4.0, 7.0, 10.0]


def test_lists_keep_their_nan():
    kind = pa.list_(pa.float32(), 4)
    made = lists(np.array([[[1.0, np.nan], [2.0, 3.0]]] * 3, dtype=np.float32), kind)
    made.validate(full=True)
    assert made.type == kind
    assert made.null_count == made.values.null_count == 0
    np.testing.assert_array_equal(made.to_pylist(), [[1.0, np.nan, 2.0, 3.0]] * 3)
