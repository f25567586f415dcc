"""passage.tif and obstacle.tif say the same, at the borders of blocks and of the parts in which blocks are rated."""

import numpy as np
import pytest
import rasterio
from ring_maps import write_points
from scenes import OTHER, Place, Scene, Solid, survey_scene
from scipy.ndimage import distance_transform_edt

import bumpymap
from bumpymap.core import OBSTACLE
from bumpymap.layers import open_map

pytestmark = pytest.mark.slow

BLOCK_M = 48.0
NODATA = 255
HALF_M = 24.0


def ridges(seed, height=0.3, waves=24):
    """Ground of ridges and humps 0.8 to 3 m wide, which hang together over many metres."""
    rng = np.random.default_rng(seed)
    wave, heading, phase = (rng.uniform(low, 2 * np.pi / size, waves) for low, size in ((1.05, 1.6), (0, 1), (0, 1)))

    def ground(x, y):
        parts = (w * (np.cos(h) * x + np.sin(h) * y) + p for w, h, p in zip(wave, heading, phase, strict=True))
        z = height * np.sqrt(2 / waves) * sum(map(np.sin, parts))
        return np.where(z > 0, z, 0.2 * z)

    return Scene("ridges", (), half=HALF_M, ground=ground)


def crowded(seed, count=200):
    """Things and walls of all sizes, in each other's reach."""
    rng = np.random.default_rng(seed)
    sizes = np.column_stack([rng.uniform(0.3, 6.0, count), rng.uniform(0.2, 1.2, count), rng.uniform(0.3, 2.0, count)])
    solids = [
        Solid(*rng.uniform(-HALF_M, HALF_M, 2), *size, turn=rng.uniform(0, 180), class_id=OTHER) for size in sizes
    ]
    return Scene("crowded", tuple(solids), half=HALF_M)


@pytest.mark.parametrize(("scene", "classified"), [(ridges(0), False), (crowded(3), False), (crowded(1), True)])
def test_the_middle_of_the_vehicle_keeps_its_distance_from_every_obstacle(tmp_path, monkeypatch, scene, classified):
    """And what stands on a tile is found with what is around it, though a part of the block is in memory at a time."""
    place = Place(0.0, 10_400 * BLOCK_M, 118_750 * BLOCK_M)  # where four blocks meet
    write_points(survey_scene(scene, 40, noise=0.01, classified=classified, place=place), tmp_path / "survey.las")
    bumpymap.map_survey(tmp_path / "survey.las", tmp_path / "layers")
    with rasterio.open(tmp_path / "layers" / "rasters/passage.tif") as file:
        areas = file.read(1)
    with rasterio.open(tmp_path / "layers" / "rasters/obstacle.tif") as file:
        apart = distance_transform_edt(file.read(1) != OBSTACLE) * file.res[0]
    is_free = (areas > 0) & (areas < NODATA)
    assert is_free.any()
    assert (apart < np.inf).any()
    assert apart[is_free].min() > 0.5 * open_map(tmp_path / "layers").vehicle.width_m + 0.09
    monkeypatch.setattr("bumpymap.survey.engine.budget.Budget.block_points", 3_000)
    monkeypatch.setattr("bumpymap.survey.second_pass.KEPT_BYTES", 30_000)
    bumpymap.map_survey(tmp_path / "survey.las", tmp_path / "parts")
    rasters = [f"rasters/{name}.tif" for name in ("roughness", "barred", "obstacle", "passage")]
    for name in (*rasters, "tiles.parquet"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "layers" / name).read_bytes()
