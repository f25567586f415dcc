"""Yards within walls, surveyed and mapped: nothing gets in or out but through a gap that the vehicle fits through."""

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import CRS
from scenes import Place, ring, survey_scene
from skimage.graph import MCP_Geometric

import bumpymap
from bumpymap.layers import ExportSettings, export_map, open_map

pytestmark = pytest.mark.slow

LETHAL = 98
"""Above this value of a cell, planners of Nav2 do not plan."""


def write(points, path):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = (0.001, 0.001, 0.001), (500_000, 5_700_000, 0)
    header.add_crs(CRS.from_epsg(32632))
    las = laspy.LasData(header)
    las.x, las.y, las.z, las.classification = points.x, points.y, points.z + 100.0, points.classification
    las.write(path)


def crosses(is_open, place, transform):
    """Whether a least-cost tool that steps to all eight neighbours gets from the yard to the ground around it."""
    rows, cols = np.nonzero(is_open)
    x, y = place.in_scene(*(transform * (cols + 0.5, rows + 0.5)))
    far = np.maximum(np.abs(x), np.abs(y))
    yard, around = (np.column_stack([rows, cols])[part] for part in (far < 9.0, far > 14.0))
    assert len(yard)
    assert len(around)
    reached = MCP_Geometric(np.where(is_open, 1.0, -1.0)).find_costs(yard[:1])[0]
    return bool(np.isfinite(reached[tuple(around.T)]).any())


@pytest.mark.parametrize(
    ("gap", "thickness", "density", "classified"),
    [(0.0, 0.1, 50, True), (0.0, 0.3, 20, True), (0.0, 0.2, 50, False), (1.0, 0.2, 50, True), (2.3, 0.2, 50, True)],
)
def test_a_wall_is_a_wall_for_all_that_read_the_map(tmp_path, gap, thickness, density, classified):
    rng = np.random.default_rng(int(100 * gap + 10 * thickness + density))
    place = Place(rng.uniform(0, 90), 500_000 + rng.uniform(0, 3), 5_700_000 + rng.uniform(0, 3))
    scene = ring(gap=gap, thickness=thickness, side=24.0)
    points = survey_scene(scene, density, classified=classified, sides=True, place=place, noise=0.01, margin=6.0)
    write(points, tmp_path / "yard.las")
    bumpymap.map_survey(tmp_path / "yard.las", tmp_path / "layers")
    start, goal = (tuple(map(float, place.of_scene(x, 0.0))) for x in (0.0, 17.0))
    fits = gap >= 2.0
    if fits:
        (route,) = bumpymap.find_routes(tmp_path / "layers", start, goal, snap=6.0)
        x, y = place.in_scene(*route.line.T)
        assert abs(np.interp(12.0, x, y)) < 0.5 * gap - 0.4
        assert route.figures.obstacle_m == 0.0
    else:
        with pytest.raises(bumpymap.BadInputError, match="come closest at"):
            bumpymap.find_routes(tmp_path / "layers", start, goal, snap=6.0)
    reach = bumpymap.map_reach(tmp_path / "layers", start, snap=6.0)
    assert bool(np.isfinite(reach.cost.sel(x=goal[0], y=goal[1], method="nearest"))) == fits
    for file in ("layers/cost.tif", "pixels/cost.tif"):
        if file.startswith("pixels"):
            export_map(open_map([tmp_path / "layers"]), tmp_path / "pixels", ExportSettings(to="cost"))
        with rasterio.open(tmp_path / file) as raster:
            is_open = np.isfinite(raster.read(1))
            assert crosses(is_open, place, raster.transform) == fits, file
    with rasterio.open(tmp_path / "layers" / "cost.tif") as raster:
        transform = raster.transform
    export_map(open_map([tmp_path / "layers"]), tmp_path / "nav2", ExportSettings(to="nav2"))
    header, _, rest = (tmp_path / "nav2" / "map.pgm").read_bytes().partition(b"\n255\n")
    cols, rows = map(int, header.split()[1:3])
    cells = np.frombuffer(rest, np.uint8).reshape(rows, cols)
    assert crosses(cells <= LETHAL, place, transform) == fits
