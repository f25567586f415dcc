"""Routes over layers that a run has written: the relief of pictures, and every file together."""

import numpy as np
import pytest
from route_maps import write_folder
from route_records import make_route

from bumpymap.core import BadInputError
from bumpymap.layers import open_map
from bumpymap.route.output import write_routes
from bumpytiles import Grid

SMALL = Grid(3.0, 4)
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.fixture(scope="module")
def folder(make_field, tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("relief") / "layers", make_field(40, 30, grid=SMALL, seed=4))


def test_coarse_relief_holds_means(folder):
    found = open_map(folder)
    whole = found.window
    blocks = found.heights(whole).reshape(whole.rows, 4, whole.cols, 4)
    known = np.isfinite(blocks).sum(axis=(1, 3))
    means = np.nansum(blocks, axis=(1, 3)) / np.where(known, known, np.nan)
    coarse = found.relief(whole, (whole.rows, whole.cols))
    full = known == 16  # an overview of an overview weighs pixels beside holes differently
    np.testing.assert_allclose(coarse[full], means[full], atol=1e-3)
    np.testing.assert_array_equal(np.isnan(coarse), known == 0)
    assert np.abs(coarse - means)[known > 0].max() < 0.5


def test_damaged_layers_leave_nothing(make_field, tmp_path):
    folder = write_folder(tmp_path / "layers", make_field(20, 16, grid=SMALL))
    found = open_map(folder)
    (folder / "heightmap.tif").write_bytes(b"II*\0 no more")
    bounds = found.grid.window_bounds(found.window)
    corners = np.array([[bounds.west + 5, bounds.south + 5], [bounds.east - 5, bounds.north - 5]])
    with pytest.raises(BadInputError, match=r"heightmap\.tif"):
        write_routes([make_route(corners=corners)], found, tmp_path / "out", manifest={})
    assert not (tmp_path / "out").exists()
