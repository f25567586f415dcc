"""The second pass shows every block its neighbours, once each, whatever the packs."""

import numpy as np
import pytest

from bumpymap.core.interrupts import SilentProgress
from bumpymap.survey import second_pass
from bumpymap.survey.second_pass import add_neighbours
from bumpytiles import BLOCK_TILES, Column, Grid, TileTable

GRID = Grid(3.0, 2)


class Neighbours:
    """Adds the heights of the tiles to the north and south, and of the pixel west of the tile's north-west pixel."""

    rings = 1
    needs = ("height", "heights", "kind", "number")
    columns = (
        Column("north", "<f4"),
        Column("south", "<f4"),
        Column("west_pixel", "<f4"),
        Column("number", "<i8"),
        Column("kinds", "|u1"),
    )

    def leaves(self, own):
        if (own["kind"] != 200).any():
            return None
        nothing = np.full(len(own["kind"]), -1.0, np.float32)
        return {
            "north": nothing,
            "south": nothing,
            "west_pixel": nothing,
            "number": own["number"] + 1,
            "kinds": own["kind"],
        }

    def __call__(self, window):
        image = window.mosaic("heights")
        assert image.shape == (18 * GRID.pixels, 18 * GRID.pixels)
        inner = slice(GRID.pixels, -GRID.pixels, GRID.pixels)
        return {
            "north": window["height"][:-2, 1:-1],
            "south": window["height"][2:, 1:-1],
            "west_pixel": image[inner, GRID.pixels - 1 : -GRID.pixels - 1 : GRID.pixels],
            "number": window.inner("number") + 1,
            "kinds": window["kind"][1:-1, 2:],
        }


@pytest.fixture(name="tiles", scope="module")
def tiles_fixture():
    rng = np.random.default_rng(5)
    place = rng.permutation(70 * 50)[:2400]
    col, row = place % 70 - 20, place // 70 - 9
    heights = rng.normal(size=(len(place), 2, 2)).astype(np.float32)
    return {
        "col": col,
        "row": row,
        "number": np.arange(len(place)),
        "height": heights.mean((1, 2)),
        "heights": heights,
        "kind": rng.integers(0, 9, len(place)).astype(np.uint8),
    }


def expected(tiles):
    by_place = {place: n for n, place in enumerate(zip(tiles["col"], tiles["row"], strict=True))}
    for n, (col, row) in enumerate(by_place):
        beside = ((col, row + 1), (col, row - 1), (col - 1, row), (col + 1, row))
        north, south, west, east = (by_place.get(place) for place in beside)
        yield (
            np.nan if north is None else tiles["height"][north],
            np.nan if south is None else tiles["height"][south],
            np.nan if west is None else tiles["heights"][west, 0, -1],
            n + 1,
            255 if east is None else tiles["kind"][east],
        )


@pytest.mark.parametrize(("threads", "kept"), [(1, second_pass.KEPT_BYTES), (3, second_pass.KEPT_BYTES), (3, 30_000)])
def test_every_tile_sees_its_neighbours(tmp_path, tiles, threads, kept, monkeypatch):
    monkeypatch.setattr(second_pass, "KEPT_BYTES", kept)
    table = add_neighbours(TileTable.of(GRID, tiles), Neighbours(), tmp_path, threads, SilentProgress())
    names = ("north", "south", "west_pixel", "number", "kinds")
    found = table.read((*names, "height"))
    order = np.argsort(found["number"])
    for name, values in zip(names, zip(*expected(tiles), strict=True), strict=True):
        np.testing.assert_array_equal(found[name][order], values)
    np.testing.assert_array_equal(found["height"][order], tiles["height"])  # columns that were there stay


def test_blocks_that_are_left_are_left_as_a_whole(tmp_path, tiles):
    """Scattered tiles beside the others, of which all but one are left; their blocks are rated together."""
    far = np.arange(100, 1100, 10)
    more = {"col": far, "row": far % 7, "number": 9000 + far, "height": far / 9, "heights": np.zeros((100, 2, 2))}
    more["kind"] = np.where(far == 500, 5, 200)
    joined = {name: np.concatenate([tiles[name], more[name]]).astype(tiles[name].dtype) for name in tiles}
    table = add_neighbours(TileTable.of(GRID, joined), Neighbours(), tmp_path, 1, SilentProgress())
    found = table.read(("north", "number", "kinds"))
    scattered = found["col"] >= 100
    assert (found["number"][scattered] == 9001 + found["col"][scattered]).all()
    beside = found["col"] // BLOCK_TILES == 500 // BLOCK_TILES  # left only if all tiles of its block are
    np.testing.assert_array_equal(found["north"] == -1.0, scattered & ~beside)
