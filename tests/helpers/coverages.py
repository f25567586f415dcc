"""What a coverage must hold, worked out from tiles and by GEOS, apart from the package."""

import numpy as np
import shapely
from scipy import ndimage


def holes_of_tiles(col, row):
    """Holes in the union of tiles: what lies inside groups of tiles that share sides."""
    filled = np.zeros((np.ptp(row) + 1, np.ptp(col) + 1), dtype=bool)
    filled[row - row.min(), col - col.min()] = True
    groups, _ = ndimage.label(filled)
    boxes = enumerate(ndimage.find_objects(groups), start=1)
    return sum(ndimage.label(~np.pad(groups[box] == number, 1))[1] - 1 for number, box in boxes)


def check_coverage(polygons, holes=None):
    """Every polygon is valid, they fit together without a gap, and their union has as many holes as expected."""
    assert shapely.is_valid(polygons).all()
    assert shapely.coverage_is_valid(polygons)
    if holes is not None:
        whole = shapely.get_parts(shapely.coverage_union_all(polygons))
        assert shapely.get_num_interior_rings(whole).sum() == holes
