"""Made-up maps, written in sheets."""

from route_maps import RUN

from bumpymap.core.types import CostTable
from bumpymap.layers import SheetLayout, SheetRun, write_sheets
from bumpymap.views import write_map_views
from bumpytiles import BLOCK_TILES, Grid

SMALL = Grid(3.0, 5)


def write_in_sheets(cost_map, folder, *, blocks=1, keep=False, key="k", views=write_map_views):
    """Write a map in sheets with sides of so many blocks."""
    folder.mkdir(exist_ok=True, parents=True)
    layout = SheetLayout(cost_map.patches.grid, blocks * BLOCK_TILES)
    run = SheetRun(layout, key, keep, lambda _: RUN)
    local = cost_map.georeference.crs is None
    return write_sheets(CostTable.of(cost_map), folder, run, views=views, local=local, manifest=RUN)
