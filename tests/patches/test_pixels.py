"""Points of files whose grid has borders of tiles and pixels on it, against exact integers: pixels are half-open."""

from dataclasses import replace
from fractions import Fraction

import laspy
import numpy as np
from hypothesis import given, settings, strategies as st
from patch_stacks import joined_in_order

from bumpymap.core.config import FeatureSettings
from bumpymap.core.types import OBSTACLE, POINT_DECK, POINT_GROUND, POINT_OTHER, SEEN, UNDECIDED, VehicleBody
from bumpymap.patches import decks_as_ground, find_objects, measure
from bumpymap.readers import ReadOptions, open_survey
from bumpytiles import Grid, TileBuckets, photo_of

UNITS = {"m": Fraction(1), "ft": Fraction(381, 1250), "us-ft": Fraction(1200, 3937)}
SCALES, OFFSETS = ("0.001", "0.01", "0.0001"), ("0", "500000", "313700.5", "-1234.56")
GRIDS = {"3": Grid(), "1.5": Grid(1.5, 30), "1.1": Grid(1.1, 11)}
DENSE = 3000


def write(path, numbers, scale, offsets, heights, **columns):
    """A LAS file of the integers of x and y, (2, n)."""
    header = laspy.LasHeader(version="1.4", point_format=7)
    header.scales, header.offsets = [float(scale)] * 2 + [0.001], [float(offset) for offset in (*offsets, 0)]
    las = laspy.LasData(header)
    las.X, las.Y = numbers
    las.z = heights
    for name, values in columns.items():
        las[name] = values
    las.write(path)
    return path


def exact(numbers, scale, offset, unit, side, pixels):
    """Number of the pixel of each integer along an axis, counted from the origin."""
    factor, shift = (UNITS[unit] * Fraction(number) * pixels / Fraction(side) for number in (scale, offset))
    below = factor.denominator * shift.denominator
    up, start = int(factor * below), int(shift * below)
    return np.array([(number * up + start) // below for number in numbers.tolist()])


def numbers_around(rng, place, scale, offset, unit, count=DENSE):
    """Integers of coordinates within 6 m around a place [m], at least half of them on the 5 cm nearest to a border."""
    step = float(Fraction(scale) * UNITS[unit])
    wanted = place + rng.uniform(0, 6, count)
    wanted[::2] = np.round(wanted[::2] / 0.1) * 0.1
    return np.round((wanted - float(Fraction(offset) * UNITS[unit])) / step).astype(np.int64)


def blocks_of(path, unit, grid):
    reader = open_survey(path, ReadOptions(xy_unit=None if unit == "m" else unit, z_unit="m", colour=True))
    buckets = TileBuckets(grid)
    for chunk in reader.chunks():
        buckets.add_chunk(reader.convert(chunk, reader.fetch(chunk)).grouped(grid))
    return list(buckets.blocks())


def maps_of(stack):
    """Number of points and mean height of every pixel that has points, by row (from the south) and column."""
    t, north, col = np.nonzero(stack.spread_count)
    px = stack.grid.pixels
    keys = np.stack([stack.row[t] * px + px - 1 - north, stack.col[t] * px + col], axis=1).tolist()
    held = zip(stack.spread_count[t, north, col], stack.heights[t, north, col], strict=True)
    return dict(zip(map(tuple, keys), held, strict=True))


@settings(max_examples=40)
@given(
    st.integers(0, 1 << 30),
    st.sampled_from(SCALES),
    st.tuples(st.sampled_from(OFFSETS), st.sampled_from(OFFSETS)),
    st.sampled_from(list(UNITS)),
    st.tuples(*2 * [st.integers(-7_000_000, 7_000_000)]),
    st.sampled_from(list(GRIDS)),
)
def test_every_pixel_holds_the_points_that_exact_arithmetic_gives_it(
    tmp_path_factory, seed, scale, offsets, unit, place, side
):
    """Whatever scale, offset and unit a file has, whatever the sign of its coordinates."""
    rng, grid = np.random.default_rng(seed), GRIDS[side]
    reach = 0.9 * 2**31 * float(Fraction(scale) * UNITS[unit])
    middle = [float(Fraction(offset) * UNITS[unit]) for offset in offsets]
    place = [min(max(at, own - reach), own + reach) for at, own in zip(place, middle, strict=True)]
    numbers = [numbers_around(rng, at, scale, offset, unit) for at, offset in zip(place, offsets, strict=True)]
    # No two points at one place: of twins, one counts.
    numbers = np.unique(np.array(numbers), axis=1)
    heights = rng.integers(0, 100, numbers.shape[1]) / 1000
    path = write(tmp_path_factory.mktemp("pixels") / "a.las", numbers, scale, offsets, heights)
    stack = joined_in_order(measure(b, FeatureSettings(), ground_only=False) for b in blocks_of(path, unit, grid))
    col, row = (
        exact(axis, scale, offset, unit, side, grid.pixels) for axis, offset in zip(numbers, offsets, strict=True)
    )
    places, at, count = np.unique(np.stack([row, col]), axis=1, return_inverse=True, return_counts=True)
    found = sorted(maps_of(stack).items())
    assert [key for key, _ in found] == list(map(tuple, places.T.tolist()))
    assert [own for _, (own, _) in found] == count.tolist()
    np.testing.assert_allclose([own for _, (_, own) in found], np.bincount(at.ravel(), heights) / count, atol=1e-6)


def test_objects_decks_and_photos_have_the_pixels_of_the_heights(tmp_path):
    """On a grid of centimetres far from the origin, where 15 * (x - west) / 3 falls to either side of a border."""
    rng, corner = np.random.default_rng(4), (413_700, 5_403_200)
    numbers = np.unique(rng.integers(0, 60, (2, 4000)) * 5, axis=1)
    kind = rng.choice([POINT_GROUND, POINT_OTHER], numbers.shape[1], p=[0.9, 0.1]).astype(np.uint8)
    z, white = 1.0 * (kind == POINT_OTHER), np.where(kind == POINT_OTHER, 255, 0)
    path = write(tmp_path / "a.las", numbers, "0.01", corner, z, red=white << 8, green=white << 8, blue=white << 8)
    body = VehicleBody(clearance_m=0.25, height_m=1.4, width_m=1.4, brush_stem_m=0.25)
    raised = 0
    for block in blocks_of(path, "m", Grid()):
        of_tile = np.repeat(np.arange(len(block.col)), np.diff(block.starts))
        x, y = (np.round(axis * 100).astype(np.int64) // 20 for axis in (block.easting, block.northing))
        place = of_tile, 14 - y % 15, x % 15
        is_raised = block.upward > 0.5
        expected = np.zeros((len(block.col), 15, 15), bool)
        expected[tuple(axis[is_raised] for axis in place)] = True
        assert np.array_equal(photo_of(block).any(axis=-1), expected)
        marked = replace(block, flag=np.where(is_raised, POINT_OTHER, POINT_GROUND).astype(np.uint8))
        states = find_objects(marked, measure(marked, FeatureSettings(), ground_only=True), body).objects % SEEN
        assert np.array_equal((states == OBSTACLE) | (states == UNDECIDED), expected)
        decks = decks_as_ground(replace(block, flag=np.where(is_raised, POINT_DECK, POINT_GROUND).astype(np.uint8)))
        assert np.array_equal(decks.flag == POINT_OTHER, expected[place] & ~is_raised)
        raised += expected.sum()
    assert raised > 100
