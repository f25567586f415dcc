"""Zones: pieces of ground that hang together, against one labelling of the whole mosaic; what joins and parts them."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings, strategies as st
from scipy import ndimage
from small_surveys import run, write_las

from bumpymap.core import Barred, VehicleBody, corners_join, obstacle_reach
from bumpymap.layers import open_map
from bumpymap.survey import second_pass
from bumpytiles import BLOCK_TILES, Grid, TileTable

GRID = Grid(0.6, 3)
WIDE, NARROW = (VehicleBody(clearance_m=0.2, height_m=1.0, width_m=width, brush_stem_m=0.2) for width in (1.4, 0.3))


def together(body):
    joins = corners_join(body.width_m, obstacle_reach(body.width_m), GRID.pixel_size)
    return ndimage.generate_binary_structure(2, 2 if joins else 1)


def areas_of(free, body):
    """The areas of a tile, numbered from 1, the largest."""
    labels, count = ndimage.label(free, together(body))
    order = np.argsort(-np.bincount(labels.ravel(), minlength=count + 1)[1:], kind="stable")
    number = np.zeros(count + 1, np.uint8)
    number[order + 1] = np.arange(1, count + 1)
    return number[labels]


def zones_of(table, body):
    with TemporaryDirectory() as folder:
        return second_pass.add_zones(table, body, Path(folder)).read(("zone", "barred", "passage"))


def expected(found, body):
    """The zones by one labelling of all pixels; tiles are ordered north first, then west first."""
    px, row, col = GRID.pixels, found["row"].max() - found["row"], found["col"] - found["col"].min()
    mosaic = np.zeros((row.max() + 1, px, col.max() + 1, px), bool)
    mosaic[row, :, col, :] = found["passage"] > 0
    labels = ndimage.label(mosaic.reshape((row.max() + 1) * px, -1), together(body))[0].reshape(mosaic.shape)
    piece = np.array(
        [labels[r, :, c][areas == 1].max(initial=0) for r, c, areas in zip(row, col, found["passage"], strict=True)]
    )
    open_tiles = [int(((piece == number) & (found["barred"] == 0)).sum()) for number in range(labels.max() + 1)]
    pieces = sorted(set(piece[piece > 0].tolist()), key=lambda each: (-open_tiles[each], (piece == each).argmax()))
    return np.array([0 if each == 0 else pieces.index(each) + 1 for each in piece.tolist()])


BESIDE_BORDERS = np.array([-17, -16, -15, -1, 0, 1, 15, 16, 31, 32, 47, 48])
"""Columns and rows of tiles at the borders of blocks, and between them."""


@pytest.mark.parametrize("body", [WIDE, NARROW], ids=["by corners too", "by sides alone"])
@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_zones_are_those_of_the_whole_mosaic_however_it_is_cut(body, data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    held = rng.random((12, 12)) < data.draw(st.sampled_from([0.1, 0.4, 0.95]))
    held[rng.integers(12), rng.integers(12)] = True
    row, col = (BESIDE_BORDERS[at] for at in np.nonzero(held))
    free = rng.random((len(row), GRID.pixels, GRID.pixels)) < data.draw(st.sampled_from([0.25, 0.4, 0.55, 0.8]))
    columns = {
        "col": col,
        "row": row,
        "passage": np.array([areas_of(each, body) for each in free]),
        "barred": rng.choice([Barred.NO, Barred.SPLIT], len(row)).astype(np.uint8),
    }
    order = rng.permutation(len(row))
    table = TileTable.of(GRID, {name: values[order] for name, values in columns.items()})
    with pytest.MonkeyPatch.context() as patch:
        blocks = data.draw(st.sampled_from([1, 2, 9]))
        patch.setattr(second_pass, "STRIP_PIXELS", blocks * (BLOCK_TILES * GRID.pixels) ** 2)
        found = zones_of(table, body)
    np.testing.assert_array_equal(found["zone"], expected(found, body))
    assert found["zone"].dtype == np.int32


SIDE = 30.0
"""Of a meadow, m."""


def meadow(path, opening):
    """Level ground with a wall across it, 2 m high and 0.3 m thick, with an opening of so many metres in its middle."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, SIDE, (2, int(60 * SIDE**2)))
    z = rng.normal(50.0, 0.01, len(x))
    z[(np.abs(x - 12.3) < 0.15) & (np.abs(y - 15.0) > 0.5 * opening)] += 2.0
    return write_las(path, x + 600_000, y + 4_000_002, z, offset=(600_000, 4_000_000, 0))


@pytest.mark.slow
@pytest.mark.parametrize(("opening", "pieces"), [(0.0, 2), (1.2, 2), (2.2, 1)])
def test_a_wall_parts_a_meadow_and_an_opening_for_the_vehicle_joins_it(tmp_path, opening, pieces):
    survey, layers = meadow(tmp_path / "meadow.las", opening), tmp_path / "layers"
    printed = run("map", survey, "--out", layers).stdout
    site, (west, east) = open_map(layers), np.array([[600_004.0, 4_000_017.0], [600_024.0, 4_000_017.0]])
    zones = [site.zone_at(end) for end in (west, east)]
    assert zones == ([1, 1] if pieces == 1 else [2, 1])
    assert site.zone_at(np.array([600_012.3, 4_000_005.0])) == 0  # in the wall
    assert site.zone_at(np.array([599_000.0, 4_000_005.0])) == 0  # off the map
    tiles, regions = pq.read_table(layers / "tiles.parquet"), json.loads((layers / "cost.geojson").read_text())
    passable = tiles["passable"].to_numpy()
    counts = np.bincount(tiles["zone"].to_numpy()[passable].astype(int))[1:]
    of_regions = np.zeros_like(counts)
    for properties in (feature["properties"] for feature in regions["features"]):
        if properties["passable"]:
            of_regions[properties["zone"] - 1] += properties["tiles"]
        else:
            assert properties["zone"] is None
    np.testing.assert_array_equal(of_regions, counts)
    record = json.loads((layers / "run.json").read_text())["counts"]["zones"]
    assert (record["pieces"], record["largest_tiles"], record["largest_m2"]) == (pieces, counts[0], 9.0 * counts[0])
    assert record["island_tiles"] == counts[1:].sum()
    assert f"of what can be crossed hangs together in one piece of {9 * counts[0]} m" in printed
    assert ("lie on islands under 500 m" in printed) == (pieces == 2)
    words = "route", layers, "--from", "600004,4000017", "--to", "600024,4000017"
    way = run(*words)
    assert way.exit_code == (0 if pieces == 1 else 3)
    said = f"of {9 * counts[-1]} m² (zone 2) and of {9 * counts[0]} m² (zone 1)"
    assert (said in " ".join(way.output.split())) == (pieces == 2)
