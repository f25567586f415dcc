"""Walls, steps and objects at any place of the grid and its blocks: what is closed, is seen, hangs together."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings, strategies as st
from rings import GROUND_KINDS, Ring, write_points
from scenes import GROUND, OTHER, PIXELS, TILE_SIZE, Place, Scene, ScenePoints, Solid, Wall, seen_pixels, survey_scene
from scipy import ndimage
from scipy.ndimage import distance_transform_edt
from scipy.stats import binned_statistic_2d
from small_surveys import band, run, write_las

import bumpymap
from bumpymap.core import MapConfig, SeenSizes, SilentProgress, density_for, smallest_object, smallest_step
from bumpymap.core.types import OBSTACLE, Barred, VehicleBody, corners_join, obstacle_reach, rated_columns
from bumpymap.layers import open_map
from bumpymap.rating import find_steps
from bumpymap.survey import tile_rating
from bumpymap.survey.tile_rating import NeighbourRating, RatingModels, TileRating, finish_tiles
from bumpytiles import BLOCK_TILES, Grid, TileBuckets, TileTable

pytestmark = pytest.mark.usefixtures("without_views")

TILES = 8
SIDE = 3.0 * TILES
WEST, SOUTH = 600_000.0, 4_000_002.0


@pytest.fixture(name="models", scope="module")
def models_fixture(tmp_path_factory):
    config = MapConfig((tmp_path_factory.mktemp("walls") / "none.laz",), tmp_path_factory.mktemp("out"))
    return config, RatingModels.load(config)


def survey(rng, wall, density, noise):
    """Points of level ground with a wall through it."""
    x, y = rng.uniform(0, SIDE, (2, int(density * SIDE**2)))
    return x, y, wall.ground(x, y) + rng.normal(0, noise, len(x))


def rated(models, points, folder):
    config, loaded = models
    grid = Grid()
    buckets = TileBuckets(grid)
    x, y, z = points
    buckets.add(x + WEST, y + SOUTH, z + 50.0, np.zeros(len(x), np.bool_))
    rating = TileRating.of(config, loaded)
    blocks = [rating(block, False) for block in buckets.blocks()]
    columns = {c.name: np.concatenate([block[c.name] for block in blocks]) for c in rated_columns(grid.pixels)}
    folder.mkdir()
    neighbours = NeighbourRating(config, loaded.calibration)
    table = finish_tiles(TileTable.of(grid, columns), neighbours, folder, 1, SilentProgress())
    return table.read(("barred", "class_id", "p_fail", "c_r"))


def crossed(found, wall):
    """Whether the wall runs through a tile or along its border: some of the tile, edges included, on either side."""
    west, south = found["col"] * 3.0 - WEST, found["row"] * 3.0 - SOUTH
    corners = np.stack([wall.distance(west + 3 * i, south + 3 * j) for i in (0, 1) for j in (0, 1)])
    return (corners.min(axis=0) <= 1e-9) & (corners.max(axis=0) >= -1e-9)


def from_middle(found, wall):
    """Distance of the middle of each tile from the wall, m."""
    return np.abs(wall.distance(found["col"] * 3.0 - WEST + 1.5, found["row"] * 3.0 - SOUTH + 1.5))


def inside(found):
    """Tiles whose neighbours are all there."""
    west, south = found["col"] * 3.0 - WEST, found["row"] * 3.0 - SOUTH
    return (west > 3) & (west < SIDE - 6) & (south > 3) & (south < SIDE - 6)


def walls(seed, number, height=0.0):
    """Random walls; every third runs along a border or within 0.3 m of one."""
    rng = np.random.default_rng(seed)
    for n in range(number):
        (x, y), turn = rng.uniform(9, 15, 2), rng.uniform(0, 180)
        if n % 3 == 0:
            turn = 90.0 * (n % 2)
            near = rng.choice([0.0, *rng.uniform(-0.3, 0.3, 3)])
            x, y = (x, 12.0 + near) if turn else (12.0 + near, y)
        yield rng, Wall(height, x, y, turn)


@pytest.mark.parametrize(
    ("height", "densities", "noise"),
    [
        *((height, (50, 100, 400), 0.01) for height in (0.5, 1.0, 2.0)),
        *((0.45, (density,), 0.003) for density in (200, 100, 50, 20)),
    ],
)
def test_no_wall_is_left_passable(models, tmp_path, height, densities, noise):
    """Pixels of a face that is seen from above alone hold both levels and look like things; steps beside them count."""
    missed = total = wrong = 0
    for number, (rng, wall) in enumerate(walls(int(10 * height), 12, height)):
        found = rated(models, survey(rng, wall, rng.choice(densities), noise), tmp_path / str(number))
        hit = crossed(found, wall) & inside(found)
        # A wall that only cuts a corner is that of the tile beside it: through the middle half of a tile, or a border.
        through, far = hit & (from_middle(found, wall) <= 1.5), inside(found) & (from_middle(found, wall) > 3.0)
        total += int(through.sum())
        missed += int((found["barred"][through] == Barred.NO).sum())
        wrong += int((found["barred"][far] != Barred.NO).sum())
    assert total > 40
    assert (missed, wrong) == (0, 0)


def test_a_kerb_that_the_vehicle_climbs_bars_nothing(models, tmp_path):
    for number, (rng, wall) in enumerate(walls(15, 6, 0.15)):
        found = rated(models, survey(rng, wall, 100, 0.005), tmp_path / str(number))
        assert (found["barred"][inside(found)] == Barred.NO).all()


@pytest.mark.parametrize("density", [200, 50])
@pytest.mark.parametrize(
    ("depth", "width", "barred"), [(0.4, 0.3, 0.0), (0.5, 0.5, 0.0), (0.4, 1.5, 0.9), (1.0, 1.5, 0.9)]
)
def test_a_ditch_bars_tiles_only_if_a_wheel_does_not_roll_over_it(models, tmp_path, depth, width, barred, density):
    """In a survey without classes, where the points at its sides lie far above one another as those of a wall do."""
    states = []
    for number, (rng, line) in enumerate(walls(round(100 * depth + 10 * width), 6)):
        x, y, z = survey(rng, line, density, 0.01)
        z[np.abs(line.distance(x, y)) < 0.5 * width] -= depth
        found = rated(models, (x, y, z), tmp_path / str(number))
        states.append(found["barred"][inside(found) & (from_middle(found, line) < 1.0)])
    share = np.mean(np.concatenate(states) != Barred.NO)
    assert abs(share - barred) <= 0.25


@pytest.mark.parametrize("density", [20, 100])
def test_beside_a_thin_wall_the_ride_is_that_of_the_ground(models, tmp_path, density):
    """Without classes, a wall is part of the relief; the tile is barred as an obstacle bars it, and not as a cliff."""
    for number, (rng, wall) in enumerate(walls(5, 6)):
        x, y, z = survey(rng, wall, density, 0.01)
        on_wall = np.abs(wall.distance(x, y)) < 0.15
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
        ("wall .3 m", 50, False, (0, 1)),
        ("wall .3 m", 50, True, (6, 8)),
        ("cars", 10, True, (7,)),
        ("cars", 35, True, (8,)),
        *((kind, 10, False, (5,)) for kind in GROUND_KINDS),
        *(pytest.param(kind, 50, False, (5,), marks=pytest.mark.later) for kind in GROUND_KINDS),
    ],
)
def test_no_way_leads_out_of_a_ring(tmp_path, kind, density, classified, seeds):
    """Of ``tests/benchmarks/books.py``, whose table holds 20 rings of each; seen from above alone, in part."""
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
    areas, obstacle = (band(tmp_path / f"layers/rasters/{name}.tif") for name in ("passage", "obstacle"))
    apart = distance_transform_edt(obstacle != OBSTACLE) * PIXEL_M
    is_free = (areas > 0) & (areas < NODATA)
    assert is_free.any()
    assert (apart < np.inf).any()
    assert apart[is_free].min() > 0.5 * open_map(tmp_path / "layers").vehicle.width_m + 0.09
    limit_points(block=3_000)
    monkeypatch.setattr("bumpymap.survey.tile_rating.STRIP_BLOCKS", 1)
    bumpymap.map_survey(tmp_path / "survey.las", tmp_path / "parts")
    rasters = [f"rasters/{name}.tif" for name in ("roughness", "barred", "obstacle", "passage")]
    for name in (*rasters, "tiles.parquet"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "layers" / name).read_bytes()


# ---- the narrowest object and the lowest step that a survey shows ----


BODY = VehicleBody(clearance_m=0.25, height_m=1.4, width_m=1.4, brush_stem_m=0.25)
APART, POST_TILES, STEP_TILES = 4.0, 32, 12
"""Distance of the posts, m; tiles along a side of a survey of posts, and of one with a step."""


def share_of_posts(density, width, rng, *, in_relief):
    """Share of posts of 1 m, with a square top of some width, in which an obstacle is found; seen from above alone."""
    found, side, pixel = [], POST_TILES * TILE_SIZE, TILE_SIZE / PIXELS
    posts = int(side / APART)
    x, y = rng.uniform(0, side, (2, rng.poisson(density * side**2)))
    middle = (np.indices((posts, posts)).reshape(2, -1).T + 0.5) * APART + rng.uniform(-1, 1, (posts**2, 2))
    own = middle[(x // APART).astype(int) * posts + (y // APART).astype(int)]
    on = (np.abs(x - own[:, 0]) < width / 2) & (np.abs(y - own[:, 1]) < width / 2)
    z = 0.1 * x + rng.normal(0, 0.02, len(x)) + on
    classes = np.where(on | in_relief, OTHER, GROUND)
    closed = seen_pixels(ScenePoints(x, y, z, classes), BODY)[0] == OBSTACLE
    low, high = (middle - width / 2 - 0.25) / pixel, (middle + width / 2 + 0.25) / pixel
    top = (POST_TILES + 1) * PIXELS - 1
    for (west, south), (east, north) in zip(low.astype(int), high.astype(int), strict=True):
        found.append(closed[top - north : top - south + 1, PIXELS + west : PIXELS + east + 1].any())
    return np.mean(found)


def steps_of(wall, density, noise, rng, closing=np.inf):
    """Steps of a survey of two levels."""
    side = STEP_TILES * TILE_SIZE
    x, y = rng.uniform(0, side, (2, int(density * side**2)))
    z = wall.ground(x, y) + rng.normal(0, noise, len(x))
    heights = binned_statistic_2d(side - y, x, z, "mean", STEP_TILES * PIXELS, [(0, side)] * 2).statistic
    return find_steps(heights, PIXELS, closing=closing)


def share_of_steps(height, density, noise, rng, *, closing=np.inf, surveys=4):
    """Share of the tiles on a step, at any place and angle, that find at least half of it, or are closed by it."""
    found, axis = [], (np.arange(1, STEP_TILES - 1) + 0.5) * TILE_SIZE
    for _ in range(surveys):
        wall = Wall(height, *rng.uniform(16.5, 19.5, 2), rng.uniform(0, 360))
        steps = steps_of(wall, density, noise, rng, closing)
        near = np.abs(wall.distance(*np.meshgrid(axis, axis[::-1]))) < 1.0
        tiles = steps.closed.reshape(STEP_TILES, PIXELS, STEP_TILES, PIXELS)
        closed = tiles.any(axis=(1, 3))[1:-1, 1:-1]
        found.extend((closed | (np.fmax(steps.inner, steps.edge_step) > 0.5 * height))[near])
    return np.mean(found)


PIXEL_M, TILE_M = 0.2, 3.0


@pytest.mark.parametrize(("density", "width"), [(4, 1.09), (10, 0.69), (35, 0.385), (100, 0.22)])
def test_the_narrowest_object_follows_from_the_density(density, width):
    found = SeenSizes.forecast(density, PIXEL_M, in_relief=False)
    assert found.object_m == pytest.approx(width, abs=0.01)
    assert SeenSizes.forecast(density, PIXEL_M, in_relief=True).object_m >= found.object_m
    assert 0.95 * density < density_for(width, PIXEL_M, in_relief=False) < 1.4 * density


@pytest.mark.parametrize("in_relief", [False, True])
@pytest.mark.parametrize("density", [10, 35, 100])
def test_a_post_of_that_width_is_found_in_95_percent_and_a_narrower_one_is_not(density, in_relief):
    width, rng = SeenSizes.forecast(density, PIXEL_M, in_relief=in_relief).object_m, np.random.default_rng(density)
    of_chance = 0.01  # of 576 posts
    assert share_of_posts(density, width, rng, in_relief=in_relief) > 0.95 - of_chance
    assert share_of_posts(density, 0.6 * width, rng, in_relief=in_relief) < 0.8


@pytest.mark.parametrize(
    ("density", "noise", "closing"),
    [(20, 0.01, np.inf), (100, 0.03, np.inf), pytest.param(400, 0.01, 0.28, marks=pytest.mark.later), (10, 0.03, 0.28)],
)
def test_a_step_of_that_height_is_found_and_a_lower_one_is_not(density, noise, closing):
    rng = np.random.default_rng(density)
    limit = steps_of(Wall(0.0, 0, 0, 0), density, noise, rng).limit  # of level ground
    height = float(np.median(smallest_step(limit, density, closing)))
    assert share_of_steps(height, density, noise, rng, closing=closing, surveys=8) > 0.9
    assert share_of_steps(0.4 * height, density, noise, rng, closing=closing, surveys=8) < 0.6


def tiles_of(points, tiles=300):
    """The narrowest object of tiles, and that of even ones with as many points; ``points`` makes those of a tile."""
    held, count = np.zeros((tiles, PIXELS, PIXELS), bool), np.zeros(tiles, np.int64)
    for tile in range(tiles):
        x, y = points()
        held[tile, (y / PIXEL_M).astype(int), (x / PIXEL_M).astype(int)] = True
        count[tile] = len(x)
    own = smallest_object(held, count, TILE_M, in_relief=False)
    even = [SeenSizes.forecast(each / TILE_M**2, PIXEL_M, in_relief=False).object_m for each in count]
    return own, np.minimum(even, TILE_M)


@pytest.mark.parametrize("density", [2, 10, 35, 400])
def test_points_at_random_are_even(density):
    rng = np.random.default_rng(1)
    own, even = tiles_of(lambda: rng.uniform(0, TILE_M, (2, 1 + rng.poisson(density * 9))))
    assert np.mean(own > 1.001 * even) < 0.02
    np.testing.assert_array_less(0.999 * even, own)


@pytest.mark.parametrize("apart", [0.5, 0.9, 1.5])
@pytest.mark.parametrize("turned", [False, True])
def test_lines_with_gaps_show(apart, turned):
    rng = np.random.default_rng(2)

    def lines():
        y = np.repeat(np.arange(rng.uniform(0, apart), TILE_M, apart), 100)
        place = rng.uniform(0, TILE_M, len(y)), y
        return place[::-1] if turned else place

    own, even = tiles_of(lines)
    assert np.median(own) > 0.95 * apart
    assert np.median(own) > 2 * np.median(even)


def test_the_sparser_part_of_a_tile_counts():
    rng = np.random.default_rng(3)

    def halves():
        dense, sparse = rng.poisson(100 * 4.5), rng.poisson(10 * 4.5)
        x = np.concatenate([rng.uniform(0, 1.5, dense), rng.uniform(1.5, TILE_M, sparse)])
        return x, rng.uniform(0, TILE_M, len(x))

    own, even = tiles_of(halves)
    assert np.median(even) < 0.35
    assert np.median(own) == pytest.approx(0.69, abs=0.12)
    assert tiles_of(lambda: np.array([[0.1], [0.1]]))[0].max() == TILE_M


# ---- zones: pieces of ground that hang together ----


SMALL_GRID = Grid(0.6, 3)
WIDE, NARROW = (VehicleBody(clearance_m=0.2, height_m=1.0, width_m=width, brush_stem_m=0.2) for width in (1.4, 0.3))


def together(body):
    joins = corners_join(body.width_m, obstacle_reach(body.width_m), SMALL_GRID.pixel_size)
    return ndimage.generate_binary_structure(2, 2 if joins else 1)


def areas_of(free, body):
    """The areas of a tile, numbered from 1, the largest."""
    labels, count = ndimage.label(free, together(body))
    order = np.argsort(-np.bincount(labels.ravel(), minlength=count + 1)[1:], kind="stable")
    number = np.zeros(count + 1, np.uint8)
    number[order + 1] = np.arange(1, count + 1)
    return number[labels]


def expected(found, body):
    """The zones by one labelling of all pixels; tiles are ordered north first, then west first."""
    px, row, col = SMALL_GRID.pixels, found["row"].max() - found["row"], found["col"] - found["col"].min()
    mosaic = np.zeros((row.max() + 1, px, col.max() + 1, px), bool)
    mosaic[row, :, col, :] = found["passage"] > 0
    labels = ndimage.label(mosaic.reshape((row.max() + 1) * px, -1), together(body))[0].reshape(mosaic.shape)
    piece = np.array(
        [labels[r, :, c][areas == 1].max(initial=0) for r, c, areas in zip(row, col, found["passage"], strict=True)]
    )
    open_tiles = [int(((piece == number) & (found["barred"] == 0)).sum()) for number in range(labels.max() + 1)]
    pieces = sorted(set(piece[piece > 0].tolist()), key=lambda each: (-open_tiles[each], (piece == each).argmax()))
    return np.array([0 if each == 0 else pieces.index(each) + 1 for each in piece.tolist()])


BESIDE_BORDERS = np.array([-17, -16, -15, -1, 0, 1, 15, 16, 31, 32, 47, 48])
"""Columns and rows of tiles at the borders of blocks, and between them."""


@pytest.mark.parametrize("body", [WIDE, NARROW], ids=["by corners too", "by sides alone"])
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_zones_are_those_of_the_whole_mosaic_however_it_is_cut(body, data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    held = rng.random((12, 12)) < data.draw(st.sampled_from([0.1, 0.4, 0.95]))
    held[rng.integers(12), rng.integers(12)] = True
    row, col = (BESIDE_BORDERS[at] for at in np.nonzero(held))
    free = rng.random((len(row), SMALL_GRID.pixels, SMALL_GRID.pixels)) < data.draw(
        st.sampled_from([0.25, 0.4, 0.55, 0.8])
    )
    columns = {
        "col": col,
        "row": row,
        "passage": np.array([areas_of(each, body) for each in free]),
        "barred": rng.choice([Barred.NO, Barred.SPLIT], len(row)).astype(np.uint8),
    }
    order = rng.permutation(len(row))
    table = TileTable.of(SMALL_GRID, {name: values[order] for name, values in columns.items()})
    with pytest.MonkeyPatch.context() as patch:
        blocks = data.draw(st.sampled_from([1, 2, 9]))
        patch.setattr(tile_rating, "STRIP_PIXELS", blocks * (BLOCK_TILES * SMALL_GRID.pixels) ** 2)
        with TemporaryDirectory() as folder:
            found = tile_rating.add_zones(table, body, Path(folder)).read(("zone", "barred", "passage"))
    np.testing.assert_array_equal(found["zone"], expected(found, body))
    assert found["zone"].dtype == np.int32


MEADOW_M = 30.0
"""Of a meadow, m."""


def meadow(path, opening):
    """Level ground with a wall across it, 2 m high and 0.3 m thick, with an opening of so many metres in its middle."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, MEADOW_M, (2, int(60 * MEADOW_M**2)))
    z = rng.normal(50.0, 0.01, len(x))
    z[(np.abs(x - 12.3) < 0.15) & (np.abs(y - 15.0) > 0.5 * opening)] += 2.0
    return write_las(path, x + 600_000, y + 4_000_002, z, offset=(600_000, 4_000_000, 0))


@pytest.mark.slow
@pytest.mark.parametrize(("opening", "pieces"), [(0.0, 2), (1.2, 2), (2.2, 1)])
def test_a_wall_parts_a_meadow_and_an_opening_for_the_vehicle_joins_it(tmp_path, opening, pieces):
    survey, layers = meadow(tmp_path / "meadow.las", opening), tmp_path / "layers"
    printed = run("map", survey, "--out", layers).stdout
    site, (west, east) = open_map(layers), np.array([[600_004.0, 4_000_017.0], [600_024.0, 4_000_017.0]])
    zones = [site.zone_at(end) for end in (west, east)]
    assert zones == ([1, 1] if pieces == 1 else [2, 1])
    assert site.zone_at(np.array([600_012.3, 4_000_005.0])) == 0  # in the wall
    assert site.zone_at(np.array([599_000.0, 4_000_005.0])) == 0  # off the map
    tiles, regions = pq.read_table(layers / "tiles.parquet"), json.loads((layers / "cost.geojson").read_text())
    passable = tiles["passable"].to_numpy()
    counts = np.bincount(tiles["zone"].to_numpy()[passable].astype(int))[1:]
    of_regions = np.zeros_like(counts)
    for properties in (feature["properties"] for feature in regions["features"]):
        if properties["passable"]:
            of_regions[properties["zone"] - 1] += properties["tiles"]
        else:
            assert properties["zone"] is None
    np.testing.assert_array_equal(of_regions, counts)
    record = json.loads((layers / "run.json").read_text())["counts"]["zones"]
    assert (record["pieces"], record["largest_tiles"], record["largest_m2"]) == (pieces, counts[0], 9.0 * counts[0])
    assert record["island_tiles"] == counts[1:].sum()
    assert f"of what can be crossed hangs together in one piece of {9 * counts[0]} m" in printed
    assert ("lie on islands under 500 m" in printed) == (pieces == 2)
    words = "route", layers, "--from", "600004,4000017", "--to", "600024,4000017"
    way = run(*words)
    assert way.exit_code == (0 if pieces == 1 else 3)
    said = f"of {9 * counts[-1]} m² (zone 2) and of {9 * counts[0]} m² (zone 1)"
    assert (said in " ".join(way.output.split())) == (pieces == 2)
