import numpy as np
import pytest
from hypothesis import given, strategies as st

from bumpymap.core.errors import BadInputError
from bumpymap.core.types import Georeference
from bumpymap.layers import check_extent
from bumpymap.layers.placement import MAX_TILES, Placement
from bumpytiles import Grid, TileWindow


@pytest.mark.parametrize("aligned", [False, True])
@given(
    window=st.builds(TileWindow, st.integers(-40, 40), st.integers(-40, 40), st.integers(1, 50), st.integers(1, 50)),
    side=st.integers(1, 20),
)
def test_chunks_cover_the_raster_once(aligned, window, side):
    place = Placement(Georeference(None), Grid(), window)
    raster = np.zeros((window.rows, window.cols), int)
    corners = []
    for cut in place.windows(side, aligned=aligned):
        part = cut.tiles
        assert 1 <= part.cols <= side
        assert 1 <= part.rows <= side
        assert part.col - window.col == cut.column
        assert window.row + window.rows - part.row - part.rows == cut.line
        west, north = (0, 0) if aligned else (window.col, window.row + window.rows)
        assert (part.col - west) % side == 0 or cut.column == 0
        assert (part.row + part.rows - north) % side == 0 or cut.line == 0
        raster[cut.line : cut.line + part.rows, cut.column : cut.column + part.cols] += 1
        corners.append((cut.line, cut.column))
    assert (raster == 1).all()
    assert corners == sorted(corners)


def test_limits_hold_for_tiles_and_for_pixels():
    side = int(MAX_TILES**0.5)
    check_extent(Grid(3.0, 15), TileWindow(0, 0, side, side))
    with pytest.raises(BadInputError, match="tiles"):
        check_extent(Grid(3.0, 1), TileWindow(0, 0, side + 1, side))
    with pytest.raises(BadInputError, match="pixels"):
        check_extent(Grid(3.0, 60), TileWindow(0, 0, side // 3, side // 3))
