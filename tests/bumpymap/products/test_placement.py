import numpy as np
import pytest

from bumpymap.errors import BadInputError
from bumpymap.products import MAX_TILES, Placement, check_extent
from bumpytiles import Grid, TileWindow


def test_order_is_north_first_then_west(make_map):
    place = Placement.of(make_map([5, 4, 5, 4], [1, 2, 2, 1], [0, 1, 2, 3], [0] * 4))
    assert place.order.tolist() == [1, 2, 3, 0]
    assert place.line.tolist() == [0, 0, 1, 1]
    assert place.column.tolist() == [0, 1, 0, 1]
    assert place.window == TileWindow(4, 1, 2, 2)


def test_raster_lies_north_up_with_gaps_filled(make_map):
    place = Placement.of(make_map([5, 4, 4], [1, 2, 1], [0, 1, 2], [0] * 3))
    np.testing.assert_array_equal(place.raster(np.array([7, 8, 9]), -1), [[8, -1], [9, 7]])


@pytest.mark.parametrize("everywhere", [False, True])
def test_chunks_hold_every_tile_once(make_field, everywhere):
    place = Placement.of(make_field(50, 35, holes=0.97))
    chunks = list(place.chunks(8, everywhere=everywhere))
    members = np.concatenate([chunk.members for chunk in chunks])
    assert sorted(members) == list(range(len(place.order)))
    for chunk in chunks:
        assert everywhere or len(chunk.members)
        inside = place.line[chunk.members] - chunk.line
        assert ((inside >= 0) & (inside < chunk.lines)).all()
        inside = place.column[chunk.members] - chunk.column
        assert ((inside >= 0) & (inside < chunk.columns)).all()
    covered = sum(chunk.lines * chunk.columns for chunk in chunks)
    assert (covered == place.window.cols * place.window.rows) is everywhere


def test_far_apart_sites_are_refused_before_anything_is_laid_out(make_map):
    far = make_map([0, 333_333], [0, 333_333], [0, 0], [0, 0])  # 1000 km
    with pytest.raises(BadInputError, match=r"1,000\.0 km x 1,000\.0 km.*100,000,000 tiles.*separate runs"):
        Placement.of(far)


def test_limits_hold_for_tiles_and_for_pixels():
    side = int(MAX_TILES**0.5)
    check_extent(Grid(3.0, 15), TileWindow(0, 0, side, side))
    with pytest.raises(BadInputError, match="tiles"):
        check_extent(Grid(3.0, 1), TileWindow(0, 0, side + 1, side))
    with pytest.raises(BadInputError, match="pixels"):
        check_extent(Grid(3.0, 60), TileWindow(0, 0, side // 3, side // 3))


def test_no_tiles_and_double_tiles(make_map):
    with pytest.raises(BadInputError, match="nothing to map"):
        Placement.of(make_map([], [], [], []))
    with pytest.raises(ValueError, match="same tile"):
        Placement.of(make_map([1, 2, 1], [4, 4, 4], [0, 0, 0], [0, 0, 0]))
