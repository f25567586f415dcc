import numpy as np
import pytest
from hypothesis import given, strategies as st

from bumpytiles import BLOCK_TILES, Column, Grid, Pack, PackError, TileTable, TileWindow, write_pack

COLUMNS = (Column("col", "<i8"), Column("row", "<i8"), Column("value", "<f4", (2,)))


def write(path, blocks, meta=None):
    rows = {key: len(columns["col"]) for key, columns in blocks.items()}
    write_pack(path, COLUMNS, rows, lambda column: [block[column.name] for block in blocks.values()], meta or {})
    return Pack(path)


def columns_of(tiles):
    col, row = np.array(tiles, dtype=np.int64).reshape(-1, 2).T
    return {"col": col, "row": row, "value": np.stack([col, row], axis=1).astype(np.float32)}


@pytest.fixture
def pack(tmp_path):
    return write(tmp_path / "a.pack", {(0, 0): columns_of([(1, 2), (3, 4)]), (-1, 2): columns_of([(33, -5)])}, {"n": 3})


def test_blocks_are_read_together_in_any_order_from_any_packs(tmp_path):
    rng = np.random.default_rng(1)
    sizes = [1, 2, 300, 1, 1, 0, 3, 40, 1, 2, 5, 1]
    blocks = {(n // 4 - 1, n % 4 - 2): columns_of(rng.integers(0, 99, (size, 2))) for n, size in enumerate(sizes)}
    packs = [write(tmp_path / str(first), dict(list(blocks.items())[first::3])) for first in range(3)]
    table, full = TileTable(Grid(), packs), [key for key in blocks if len(blocks[key]["col"])]
    for number in range(20):
        keys = [full[n] for n in rng.permutation(len(full))[: 1 + number]]
        for names in (["row", "value"], ["col"]):
            found = table.read_blocks(keys, names)
            assert list(found) == names
            for name in names:
                np.testing.assert_array_equal(found[name], np.concatenate([blocks[key][name] for key in keys]))


def test_added_columns_join_those_that_are_there_and_take_the_place_of_their_names(tmp_path):
    table = TileTable.of(Grid(), columns_of([(1, 2), (3, 4), (33, -5)]))
    more = (Column("value", "<i8"), Column("own", "|u1"))
    own = {"value": np.array([5, 6, 7]), "own": np.array([1, 2, 3])}
    write_pack(tmp_path / "b", more, {(-1, 2): 1, (0, 0): 2}, lambda column: [own[column.name]], {})
    found = table.with_columns([Pack(tmp_path / "b")]).read(["own", "value"])
    assert {name: values.tolist() for name, values in found.items()} == {
        "col": [3, 1, 33], "row": [4, 2, -5], "own": [3, 2, 1], "value": [7, 6, 5],
    }  # fmt: skip


def test_a_pack_appears_whole_or_not_at_all_and_damaged_it_is_refused(tmp_path, pack):
    columns = columns_of([(1, 2)])
    with pytest.raises(ValueError, match="rows need"):
        write_pack(tmp_path / "b", COLUMNS, {(0, 0): 5}, lambda column: [columns[column.name]], {})
    assert list(tmp_path.iterdir()) == [pack.path]
    content = pack.path.read_bytes()
    flipped = bytearray(content)
    flipped[-60] ^= 1
    for damaged in (b"", *(content[:keep] for keep in (4, 30, -1, -9, -40)), flipped):
        pack.path.write_bytes(damaged)
        with pytest.raises(PackError):
            Pack(pack.path)


tiles = st.sets(st.tuples(st.integers(-40, 40), st.integers(-40, 40)), min_size=1, max_size=60)


@given(tiles, st.integers(-45, 45), st.integers(-45, 45), st.integers(1, 60), st.integers(1, 60), st.integers(1, 600))
def test_a_window_and_its_strips_hold_each_of_its_tiles_once(chosen, col, row, cols, rows, most):
    table = TileTable.of(Grid(), columns_of(sorted(chosen)))
    assert table.tiles == len(chosen)
    assert table.window == TileWindow.around(*np.array(sorted(chosen)).T)
    window = TileWindow(col, row, cols, rows)
    inside = [(c, r) for c, r in chosen if col <= c < col + cols and row <= r < row + rows]
    expected = sorted(inside, key=lambda tile: (-tile[1], tile[0]))
    found = table.read(["value"], window)
    assert list(zip(found["col"].tolist(), found["row"].tolist(), strict=True)) == expected
    assert found["value"].tolist() == [list(tile) for tile in expected]
    held, corners = [], []
    for strip in table.strips(most, window):
        found = table.read([], strip)
        here = list(zip(found["col"].tolist(), found["row"].tolist(), strict=True))
        held += here
        corners.append((-strip.row, strip.col))
        assert len(here) <= most or len({(c // BLOCK_TILES, r // BLOCK_TILES) for c, r in here}) == 1
    assert corners == sorted(corners)
    assert sorted(held) == sorted(inside)
    assert table.holds(window) >= bool(held)


def test_blocks_without_tiles_do_not_count_and_the_same_tile_twice_is_refused(tmp_path):
    table = TileTable(Grid(), [write(tmp_path / "a", {(0, 0): columns_of([(1, 2)]), (9, 9): columns_of([])})])
    assert table.window == TileWindow(1, 2, 1, 1)
    assert not table.holds(TileWindow(144, 144, 16, 16))
    with pytest.raises(ValueError, match="same tile"):
        TileTable.of(Grid(), columns_of([(1, 4), (2, 4), (1, 4)])).read([])
