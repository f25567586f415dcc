"""Walls, kerbs and things at any place of the grid and its blocks: no wall that cannot be climbed is left passable."""

import numpy as np
import pytest
import rasterio
from ring_maps import write_points
from rings import GROUND_KINDS, Ring
from scenes import OTHER, Place, Scene, Solid, survey_scene
from scipy.ndimage import distance_transform_edt

import bumpymap
from bumpymap.core import OBSTACLE
from bumpymap.core.config import MapConfig
from bumpymap.core.interrupts import SilentProgress
from bumpymap.core.types import Barred, Georeference, rated_columns
from bumpymap.layers import open_map
from bumpymap.survey.second_pass import NeighbourRating, finish_tiles
from bumpymap.survey.tile_rating import RatingModels, TileRating
from bumpytiles import Grid, TileBuckets, TileTable

TILES = 8
SIDE = 3.0 * TILES
WEST, SOUTH = 600_000.0, 4_000_002.0


@pytest.fixture(name="models", scope="module")
def models_fixture(tmp_path_factory):
    config = MapConfig((tmp_path_factory.mktemp("walls") / "none.laz",), tmp_path_factory.mktemp("out"))
    return config, RatingModels.load(config)


def survey(rng, wall, height, density, noise):
    """Points of level ground with a wall through it; ``wall`` is (x, y, angle) of a point on it, and its direction."""
    x, y = rng.uniform(0, SIDE, (2, int(density * SIDE**2)))
    side = beyond(x, y, wall) > 0
    return x, y, np.where(side, height, 0.0) + rng.normal(0, noise, len(x))


def beyond(x, y, wall):
    """Signed distance from the wall, m."""
    return (x - wall[0]) * np.sin(wall[2]) - (y - wall[1]) * np.cos(wall[2])


def rated(models, points, folder):
    config, loaded = models
    grid = Grid()
    buckets = TileBuckets(grid)
    x, y, z = points
    buckets.add(x + WEST, y + SOUTH, z + 50.0, np.zeros(len(x), np.bool_))
    rating = TileRating.of(config, loaded, Georeference(None))
    blocks = [rating(block, False) for block in buckets.blocks()]
    columns = {c.name: np.concatenate([block[c.name] for block in blocks]) for c in rated_columns(grid.pixels)}
    folder.mkdir()
    neighbours = NeighbourRating(config, loaded.calibration)
    table = finish_tiles(TileTable.of(grid, columns), neighbours, folder, 1, SilentProgress())
    return table.read(("barred", "class_id", "p_fail", "c_r"))


def crossed(found, wall):
    """Whether the wall runs through a tile or along its border: some of the tile, edges included, on either side."""
    west, south = found["col"] * 3.0 - WEST, found["row"] * 3.0 - SOUTH
    corners = np.stack([beyond(west + 3 * i, south + 3 * j, wall) for i in (0, 1) for j in (0, 1)])
    return (corners.min(axis=0) <= 1e-9) & (corners.max(axis=0) >= -1e-9)


def from_middle(found, wall):
    """Distance of the middle of each tile from the wall, m."""
    return np.abs(beyond(found["col"] * 3.0 - WEST + 1.5, found["row"] * 3.0 - SOUTH + 1.5, wall))


def inside(found):
    """Tiles whose neighbours are all there."""
    west, south = found["col"] * 3.0 - WEST, found["row"] * 3.0 - SOUTH
    return (west > 3) & (west < SIDE - 6) & (south > 3) & (south < SIDE - 6)


def walls(seed, number):
    """Random walls; every third runs along a border or within 0.3 m of one."""
    rng = np.random.default_rng(seed)
    for n in range(number):
        x, y = rng.uniform(9, 15, 2)
        angle = rng.uniform(0, np.pi)
        if n % 3 == 0:
            angle = (n % 2) * np.pi / 2
            near = rng.choice([0.0, *rng.uniform(-0.3, 0.3, 3)])
            x, y = (12.0 + near, y) if angle else (x, 12.0 + near)
        yield rng, (x, y, angle)


@pytest.mark.parametrize("height", [0.5, 1.0, 2.0])
def test_no_wall_is_left_passable(models, tmp_path, height):
    missed = total = wrong = 0
    for number, (rng, wall) in enumerate(walls(int(10 * height), 12)):
        found = rated(models, survey(rng, wall, height, rng.choice([50, 100, 400]), 0.01), tmp_path / str(number))
        hit = crossed(found, wall) & inside(found)
        # A wall that only cuts a corner is that of the tile beside it: through the middle half of a tile, or a border.
        through, far = hit & (from_middle(found, wall) <= 1.5), inside(found) & (from_middle(found, wall) > 3.0)
        total += int(through.sum())
        missed += int((found["barred"][through] == Barred.NO).sum())
        wrong += int((found["barred"][far] != Barred.NO).sum())
    assert total > 40
    assert (missed, wrong) == (0, 0)


@pytest.mark.parametrize("density", [200, 100, 50, 20])
@pytest.mark.parametrize("height", [0.45, 0.6, 1.0])
def test_a_step_seen_from_above_alone_is_closed_wherever_its_face_falls(models, tmp_path, height, density):
    """Pixels of the face that hold both levels look like things; the steps beside them count all the same."""
    rng, found_open = np.random.default_rng(16), []
    for number in range(10):
        angle = np.radians((0, 90, 30, 45, 71)[number % 5])
        wall = (12.0 + rng.uniform(-1.5, 1.5), 12.0 + rng.uniform(-1.5, 1.5), angle)
        found = rated(models, survey(rng, wall, height, density, 0.003), tmp_path / str(number))
        through, far = (
            inside(found) & (from_middle(found, wall) < 1.0),
            inside(found) & (from_middle(found, wall) > 4.0),
        )
        found_open += found["barred"][through].tolist()
        assert (found["barred"][far] == Barred.NO).all()
    assert len(found_open) > 20
    assert Barred.NO not in found_open


def test_a_kerb_that_the_vehicle_climbs_bars_nothing(models, tmp_path):
    for number, (rng, wall) in enumerate(walls(15, 6)):
        found = rated(models, survey(rng, wall, 0.15, 100, 0.005), tmp_path / str(number))
        assert (found["barred"][inside(found)] == Barred.NO).all()


@pytest.mark.parametrize("density", [200, 50])
@pytest.mark.parametrize(
    ("depth", "width", "barred"), [(0.4, 0.3, 0.0), (0.5, 0.5, 0.0), (0.4, 1.5, 0.9), (1.0, 1.5, 0.9)]
)
def test_a_ditch_bars_tiles_only_if_a_wheel_does_not_roll_over_it(models, tmp_path, depth, width, barred, density):
    """In a survey without classes, where the points at its sides lie far above one another as those of a wall do."""
    states = []
    for number, (rng, line) in enumerate(walls(round(100 * depth + 10 * width), 6)):
        x, y, z = survey(rng, line, 0.0, density, 0.01)
        z[np.abs(beyond(x, y, line)) < 0.5 * width] -= depth
        found = rated(models, (x, y, z), tmp_path / str(number))
        states.append(found["barred"][inside(found) & (from_middle(found, line) < 1.0)])
    share = np.mean(np.concatenate(states) != Barred.NO)
    assert abs(share - barred) <= 0.25


@pytest.mark.parametrize("density", [20, 100])
def test_beside_a_thin_wall_the_ride_is_that_of_the_ground(models, tmp_path, density):
    """Without classes, a wall is part of the relief; the tile is barred as an obstacle bars it, and not as a cliff."""
    for number, (rng, wall) in enumerate(walls(5, 6)):
        x, y, z = survey(rng, wall, 0.0, density, 0.01)
        on_wall = np.abs(beyond(x, y, wall)) < 0.15
        found, level = (
            rated(models, (x, y, height), tmp_path / f"{number}-{name}")
            for name, height in (("walled", z + 2.0 * on_wall), ("level", z))
        )
        asked = inside(found)
        assert np.isin(found["barred"][asked], (Barred.NO, Barred.OBSTACLE, Barred.SPLIT)).mean() > 0.9
        assert (found["barred"][asked & crossed(found, wall)] != Barred.NO).any()
        np.testing.assert_allclose(np.nanmedian(found["c_r"][asked]), np.median(level["c_r"][asked]), atol=0.004)


WIDTH_M = 1.37
"""Of the Warthog."""


@pytest.mark.parametrize(
    ("kind", "density", "classified", "seeds"),
    [
        ("wall .3 m", 50, False, (0, 1, 2)),
        ("wall .3 m", 50, True, (6, 7, 8)),
        ("cars", 10, True, (6, 7)),
        ("cars", 35, True, (8,)),
        *((kind, density, False, (5,)) for kind in GROUND_KINDS for density in (10, 50)),
    ],
)
def test_no_way_leads_out_of_a_ring(tmp_path, kind, density, classified, seeds):
    """Of ``tests/benchmarks/ring_book.py``, whose table holds 20 rings of each; seen from above alone, in part."""
    for seed in seeds:
        noise, sides = (0.0, 0.02, 0.05)[seed % 3], bool(seed // 3 % 2)
        (tmp_path / str(seed)).mkdir()
        ring = Ring(kind, 0.0, density, noise, classified, sides, seed=seed)
        assert ring.way_out(ring.map(tmp_path / str(seed))) is None


@pytest.mark.parametrize(
    ("kind", "bar_m", "seed"),
    [
        ("wall .3 m", None, 1),
        ("wall .3 m", 2.0, 6),
        ("cars", None, 5),  # some lie across the edge of a block
        ("cars", None, 0),
        ("ditch 1 m", None, 2),
        ("drop 1.2 m", None, 3),
    ],
)
def test_the_way_leads_through_the_gap(tmp_path, kind, bar_m, seed):
    ring = Ring(kind, 3.0 * WIDTH_M, 100, 0.02, classified=bar_m is not None, bar_m=bar_m, seed=seed)
    assert ring.leads_through(ring.way_out(ring.map(tmp_path)))


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


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "classified"), [(ridges(0), False), (crowded(3), False), (crowded(1), True)])
def test_the_middle_of_the_vehicle_keeps_its_distance_from_every_obstacle(
    tmp_path, monkeypatch, limit_points, scene, classified
):
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
    limit_points(block=3_000)
    monkeypatch.setattr("bumpymap.survey.second_pass.STRIP_BLOCKS", 1)
    bumpymap.map_survey(tmp_path / "survey.las", tmp_path / "parts")
    rasters = [f"rasters/{name}.tif" for name in ("roughness", "barred", "obstacle", "passage")]
    for name in (*rasters, "tiles.parquet"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "layers" / name).read_bytes()
