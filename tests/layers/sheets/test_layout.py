import pytest
from hypothesis import given, strategies as st

from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.layers import SheetLayout, check_extent, suggested_sheets
from bumpytiles import Grid, TileWindow


@pytest.mark.parametrize(("grid", "kilometres"), [(Grid(), 0.02), (Grid(), 31), (Grid(0.1, 5), 5), (Grid(3.0, 60), 10)])
def test_sheets_that_cannot_be_made(grid, kilometres):
    with pytest.raises(UsageError, match=r"a side of at least .* km .* and at most .* km, the largest map") as caught:
        SheetLayout.of(grid, kilometres)
    assert f"`sheets={suggested_sheets(grid):g}`" in str(caught.value)


@given(st.builds(Grid, st.floats(0.05, 1000.0), st.integers(3, 255)))
def test_the_suggested_size_can_be_made_and_a_full_sheet_is_a_map(grid):
    layout = SheetLayout.of(grid, suggested_sheets(grid))
    check_extent(grid, layout.window((-1, 2)))


@given(st.integers(-5000, 5000), st.integers(-5000, 5000))
def test_a_name_is_that_of_one_place(col, row):
    layout = SheetLayout(Grid(), 1664)
    name = layout.name((col, row))
    letters = {"e": 1, "w": -1, "n": 1, "s": -1}
    across, along = name.split("_")
    assert (letters[across[0]] * int(across[1:]), letters[along[0]] * int(along[1:])) == (col, row)
    assert len(name) == 11


def test_too_many_sheets_are_refused_with_a_size_that_would_do():
    layout = SheetLayout.of(Grid(), 5)
    layout.check_whole(TileWindow(0, 0, 1664 * 100, 1664 * 100))
    window = TileWindow(-1, 0, 1664 * 300, 1664 * 100)
    with pytest.raises(BadInputError, match="301 x 100 sheets") as caught:
        layout.check_whole(window)
    size = float(str(caught.value).split("`sheets=")[1].split("`")[0])
    SheetLayout.of(Grid(), size).check_whole(window)
