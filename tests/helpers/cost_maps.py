"""Made-up maps: every class and reason, gaps, holes; regions of small ones; a site surveyed twice; stacks of tiles."""

from dataclasses import dataclass, fields, replace

import numpy as np
from pyproj import CRS

from bumpymap.core import CANOPY, FREE, OBSTACLE, SIDES, UNSEEN, CostTable, ObjectStack
from bumpymap.core.types import NO_CLASS, CostMap, CostRule, Georeference, PatchStack, Reason
from bumpymap.layers.vector import GeoJsonCoordinates, dissolve, flatgeobuf_writer, geojson_writer
from bumpymap.patches import join_stacks
from bumpytiles import Grid, TileBuckets, TileTable

UTM = CRS.from_epsg(32614)
SPEEDS = ((0.15, 1.5), (0.4, 0.5))
RULE = CostRule(ride_weight=2.5, fail_weight=300.0, drive_m=10.0, slope_limit_deg=25.0, speeds=SPEEDS)


def patch_stack(count, grid=None, **columns):
    """Patches of which a test needs a few columns; the others are zero."""
    names = [field.name for field in fields(PatchStack) if field.name != "grid"]
    return PatchStack(grid or Grid(), **{name: np.zeros(count) for name in names} | columns)


def lone_columns(cost_map):
    """The columns of finished tiles, each judged without its neighbours: no step is known."""
    columns = cost_map.columns()
    unknown = np.full(len(cost_map.class_id), np.nan, np.float32)
    columns |= dict.fromkeys(
        ("edge_step", "inner_step", "smallest_step", "c_r_open", "p_fail_open", *(f"step_{side}" for side in SIDES)),
        unknown,
    )
    columns["barred"] = cost_map.rule.barred(columns)
    columns["passable"] = passable = (columns["barred"] == 0).astype(np.uint8)
    columns["zone"] = passable.astype(np.int32)
    closed = np.isin(columns["objects"], (OBSTACLE, UNSEEN))
    columns["passage"] = np.where(closed, np.uint8(0), passable[:, None, None])
    return columns


def table_of(cost_map):
    tiles = TileTable.of(cost_map.patches.grid, lone_columns(cost_map))
    return CostTable(cost_map.georeference, cost_map.rule, tiles)


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeMap(CostMap):
    """Rated tiles, with their place on Earth and the rule of their cost."""

    georeference: Georeference
    rule: CostRule


def make_map(col, row, class_id, reason, *, georeference=None, grid=None, seed=5, easy=False):
    """CostMap of given tiles, classes and reasons; every other number is drawn at random.

    ``easy`` ground is level and fails no drive: all of it with a class is passable.
    """
    rng = np.random.default_rng(seed)
    grid = grid or Grid()
    col, row = np.asarray(col, np.int64), np.asarray(row, np.int64)
    class_id, reason = np.asarray(class_id, np.uint8), np.asarray(reason, np.uint8)
    n, known = len(col), class_id != NO_CLASS
    heights = rng.normal(2000.0, 0.3, (n, grid.pixels, grid.pixels)).astype(np.float32)
    heights[rng.random(heights.shape) < 0.2] = np.nan
    relief = rng.normal(0.0, 0.1, heights.shape).astype(np.float32)
    chance = rng.dirichlet(np.ones(4), n).astype(np.float32)
    chance[~known] = np.nan
    low, middle, high = np.sort(rng.gamma(2.0, 0.1, (3, n)).astype(np.float32), axis=0)
    low[~known] = middle[~known] = high[~known] = np.nan
    plane = np.where(reason == Reason.TOO_FEW_POINTS, np.nan, rng.random(n))
    patches = PatchStack(
        grid=grid,
        col=col,
        row=row,
        count=rng.integers(1, 5000, n),
        z_min=1999.0 - rng.random(n),
        z_max=2001.0 + rng.random(n),
        z_variance=rng.random(n),
        ransac_residual=plane,
        slope=np.where(easy, 0.0, plane * 30.0),
        z_range=rng.random(n),
        density=rng.random(n) * 500.0,
        coverage=rng.random(n),
        heights=heights,
        spread_count=rng.integers(0, 9, heights.shape).astype(np.int32),
        spread_variance=np.abs(relief),
        relief_map=relief,
        relief=np.where(known, rng.random(n), np.nan),
        reason=reason,
    )
    return MadeMap(
        georeference=georeference or Georeference(UTM),
        patches=patches,
        probability=chance,
        class_id=class_id,
        c_r=middle,
        c_r_low=low,
        c_r_high=high,
        p_fail=np.where(known, 0.0 if easy else rng.random(n), np.nan).astype(np.float32),
        confidence=np.where(known, rng.random(n), np.nan).astype(np.float32),
        rule=RULE,
    )


def make_field(cols, rows, *, west=110_000, south=680_000, holes=0.15, seed=3, **options):
    """Map of cols x rows tiles, smooth patches of class, some unknown, some missing; shuffled."""
    rng = np.random.default_rng(seed)
    rough = rng.normal(size=(rows, cols))
    for _ in range(3):
        rough += np.roll(rough, 1, 0) + np.roll(rough, 1, 1)
    class_id = np.digitize(rough, np.quantile(rough, [0.25, 0.5, 0.75])).astype(np.uint8)
    unknown = rng.random(class_id.shape) < 0.2
    class_id[unknown] = NO_CLASS
    reason = np.where(unknown, rng.integers(2, 6, class_id.shape), 0)
    row, col = np.nonzero(rng.random(class_id.shape) >= holes)
    shuffle = rng.permutation(len(row))
    row, col = row[shuffle], col[shuffle]
    return make_map(col + west, row + south, class_id[row, col], reason[row, col], seed=seed, **options)


def with_objects(cost_map, seed=9):
    """The same map with obstacles on its ground, and pixels where nothing was seen."""
    rng = np.random.default_rng(seed)
    tiles, pixels = len(cost_map.class_id), cost_map.patches.grid.pixels
    kinds = np.array([FREE, OBSTACLE, CANOPY, UNSEEN], np.uint8)
    objects = rng.choice(kinds, (tiles, pixels, pixels), p=(0.9, 0.03, 0.03, 0.04))
    share = (objects == OBSTACLE).mean(axis=(1, 2)).astype(np.float32)
    height, canopy = np.where(share > 0, 0.5, 0.0).astype(np.float32), (objects == CANOPY).mean(axis=(1, 2))
    bare = ObjectStack.empty(tiles, pixels)
    stack = replace(bare, objects=objects, obstacle=share, obstacle_height=height, canopy=canopy.astype(np.float32))
    return replace(cost_map, objects=stack)


def regions_of(cost_map):
    """Regions of a small map, which come at once."""
    (regions,) = dissolve(table_of(cost_map))
    return regions


def write_geojson(regions, path, *, local, about=None):
    place = GeoJsonCoordinates.of(regions.placement, local=local)
    with geojson_writer(path, place, about) as add:
        add(regions)


def write_flatgeobuf(regions, path):
    with flatgeobuf_writer(path, regions.placement) as add:
        add(regions)


ROWS, COLS = 30, 40
WEST, SOUTH = 160_000, 712_000
PIXELS = 15
RUT = [(14, col) for col in range(40)]
"""Rows (from the north) and columns of the tiles with a rut."""


def survey(
    seed, *, noise=0.03, rise=0.0, rut=0.0, lowered=0.0, seen=1.0, c_r=None, tiles=None, shift=(0.0, 0.0),
    tilt=(0.0, 0.0), relief=1.0, **options,
):  # fmt: skip
    """One survey.

    ``rut`` is the depth, m, of a groove of three pixels along ``RUT``, ``lowered`` that of these tiles as a whole,
    ``seen`` a share of the pixels, ``c_r`` a factor on the ride cost of these tiles; ``shift`` is how
    far east and north all lies, m, ``tilt`` the rise eastwards and northwards, ``relief`` a factor on the hills.
    """
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[0:ROWS, 0:COLS]
    kept = np.ones((ROWS, COLS), bool) if tiles is None else tiles
    row, col = row[kept], col[kept]
    n = len(row)
    grid = options.pop("grid", None) or Grid(3.0, PIXELS)
    pixel = (np.arange(grid.pixels) + 0.5) / grid.pixels
    north = (SOUTH + ROWS - row)[:, None, None] - pixel[None, :, None]
    east = (WEST + col)[:, None, None] + pixel[None, None, :]
    lies_east, lies_north = east - shift[0] / 3.0, north - shift[1] / 3.0  # in tiles
    heights = 200.0 + relief * (np.sin(lies_east / 3.0) + 0.5 * np.cos(lies_north / 2.0)) + rise
    heights += 3.0 * (tilt[0] * (east - WEST) + tilt[1] * (north - SOUTH))
    heights += noise * rng.standard_t(4, heights.shape)
    in_rut = np.isin(row * COLS + col, [r * COLS + c for r, c in RUT])
    heights[in_rut, 6:9] -= rut
    heights[in_rut] -= lowered
    heights[rng.random(heights.shape) >= seen] = np.nan
    made = make_map(
        WEST + col, SOUTH + ROWS - 1 - row, np.zeros(n), np.zeros(n), grid=grid, seed=1, easy=True, **options
    )
    ride = np.full(n, 0.1) * np.exp(rng.normal(0.0, 0.05, n))
    if c_r is not None:
        ride = ride * np.where(in_rut, c_r, 1.0)
    ride = ride.astype(np.float32)
    patches = replace(
        made.patches, heights=heights.astype(np.float32), density=np.full(n, 100.0 * seen), coverage=np.full(n, seen)
    )
    bands = {"c_r": ride, "c_r_low": ride * np.float32(0.88), "c_r_high": ride * np.float32(1.13)}
    return replace(made, patches=patches, probability=None, p_fail=np.full(n, 0.01, np.float32), **bands)


def joined_in_order(stacks):
    """Put stacks together, north to south, then west to east."""
    whole = join_stacks(list(stacks))
    order = np.lexsort((whole.col, -whole.row))
    return replace(whole, **{f.name: getattr(whole, f.name)[order] for f in fields(whole) if f.name != "grid"})


def block_of(x, y, z, flag=None):
    """The last block of points on tiles of 3 m."""
    buckets = TileBuckets(Grid())
    buckets.add(*(np.asarray(axis, float) for axis in (x, y, z)), np.zeros(len(x), bool) if flag is None else flag)
    return list(buckets.blocks())[-1]
