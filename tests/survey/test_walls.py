"""Walls and kerbs at any place relative to the grid: no wall that the vehicle cannot climb is left passable."""

import numpy as np
import pytest

from bumpymap.core.config import MapConfig
from bumpymap.core.interrupts import SilentProgress
from bumpymap.core.types import Barred, Georeference, rated_columns
from bumpymap.survey.second_pass import NeighbourRating, finish_tiles
from bumpymap.survey.tile_rating import RatingModels, TileRating
from bumpytiles import Grid, TileBuckets, TileTable

TILES, MARGIN = 8, 2
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
    table = finish_tiles(TileTable.of(grid, columns), NeighbourRating.of(config, loaded), folder, 1, SilentProgress())
    return table.read(("barred", "class_id", "p_fail", "c_r"))


def crossed(found, wall):
    """Whether the wall runs through a tile or along its border: some of the tile, edges included, on either side."""
    west, south = found["col"] * 3.0 - WEST, found["row"] * 3.0 - SOUTH
    corners = np.stack([beyond(west + 3 * i, south + 3 * j, wall) for i in (0, 1) for j in (0, 1)])
    return (corners.min(axis=0) <= 1e-9) & (corners.max(axis=0) >= -1e-9)


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
        through = hit & (np.abs(beyond(found["col"] * 3 - WEST + 1.5, found["row"] * 3 - SOUTH + 1.5, wall)) <= 1.5)
        total += int(through.sum())
        missed += int((found["barred"][through] == Barred.NO).sum())
        far = np.abs(beyond(found["col"] * 3 - WEST + 1.5, found["row"] * 3 - SOUTH + 1.5, wall)) > 3.0
        wrong += int((found["barred"][far & inside(found)] != Barred.NO).sum())
    assert total > 40
    assert missed == 0
    assert wrong == 0


@pytest.mark.parametrize("height", [0.05, 0.15])
def test_a_kerb_that_the_vehicle_climbs_bars_nothing(models, tmp_path, height):
    for number, (rng, wall) in enumerate(walls(int(100 * height), 6)):
        found = rated(models, survey(rng, wall, height, 100, 0.005), tmp_path / str(number))
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
        middle = beyond(found["col"] * 3 - WEST + 1.5, found["row"] * 3 - SOUTH + 1.5, line)
        states.append(found["barred"][inside(found) & (np.abs(middle) < 1.0)])
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
        np.testing.assert_allclose(np.nanmedian(found["c_r"][asked]), np.median(level["c_r"][asked]), atol=0.003)
