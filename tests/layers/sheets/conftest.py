"""A map in sheets, and the same map without."""

import pytest
from cost_maps import make_field
from route_maps import RUN
from sheet_maps import SMALL, write_in_sheets

from bumpymap.core.types import CostTable
from bumpymap.layers import write_products
from bumpymap.views import write_map_views


@pytest.fixture(scope="module")
def made():
    """A map on both sides of the CRS origin, with gaps."""
    return make_field(70, 50, grid=SMALL, west=-37, south=-20, seed=8)


@pytest.fixture(scope="module")
def whole(made, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    write_products(CostTable.of(made), folder, views=write_map_views, local=False, manifest=RUN)
    return folder


@pytest.fixture(scope="module")
def sheets(made, tmp_path_factory):
    folder = tmp_path_factory.mktemp("parent") / "sheets of a map"
    write_in_sheets(made, folder, blocks=4)
    return folder
