import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bumpymap.core.errors import BadInputError
from bumpymap.readers import PointStats, ReadOptions
from bumpymap.readers.point_stats import EARTH_LIMIT, verify
from bumpymap.readers.point_table import convert_points
from bumpytiles import Bounds

BOX = Bounds(0.0, 0.0, 100.0, 50.0)

numbers = st.one_of(st.floats(-150, 150), st.sampled_from([np.nan, np.inf, -np.inf, 1e12, -1e12, 101.0, -1.0, 51.5]))
rows = st.lists(st.tuples(numbers, numbers, numbers, st.sampled_from([0, 1, 2, 7, 18])), max_size=40)


def batch(points, *, first=0, no_return=False):
    x, y, z, class_id = np.array(points, float).reshape(-1, 4).T.copy()
    return convert_points((x, y, z), class_id, first, nan_is_no_return=no_return, kinds=ReadOptions().kinds)


@settings(deadline=None, max_examples=100)
@given(rows, st.booleans(), st.integers(0, 10**12))
def test_rows_of_a_table_are_counted_and_dropped(points, no_return, first):
    table = np.array(points, float).reshape(-1, 4)
    x, y, z, class_id = table.T
    found = batch(points, first=first, no_return=no_return)
    stats = found.stats
    empty = np.isnan(table[:, :3]).any(axis=1) & no_return
    bad = ~np.isfinite(table[:, :3]).all(axis=1) & ~empty
    noise = np.isin(class_id, (7, 18)) & ~empty
    assert stats.points == len(table)
    assert stats.dropped == {"withheld": 0, "noise": int(noise.sum()), "not_a_number": int(empty.sum())}
    assert stats.not_finite == bad.sum()
    assert stats.first_not_finite == (first + int(bad.argmax()) if bad.any() else -1)
    sides = (x, -np.inf), (y, -np.inf), (-x, -np.inf), (-y, -np.inf), (np.abs(z), 0.0)
    east, north, west, south, highest = (np.fmax.reduce(values, initial=start) for values, start in sides)
    assert (stats.west, stats.south, stats.east, stats.north) == (-west, -south, east, north)
    assert stats.highest == highest
    keep = ~(empty | noise) & (not stats.bad)
    cloud = found.cloud
    assert np.array_equal(
        np.column_stack([cloud.easting, cloud.northing, cloud.upward]), table[keep, :3], equal_nan=True
    )
    assert np.array_equal(cloud.is_ground, class_id[keep] == 2)


@settings(deadline=None)
@given(rows, st.data())
def test_stats_of_parts_add_up_however_they_are_grouped(points, data):
    cut = sorted(data.draw(st.lists(st.integers(0, len(points)), max_size=4)))
    edges = list(zip([0, *cut], [*cut, len(points)], strict=True))
    parts = [batch(points[low:high], first=low).stats for low, high in edges]
    whole = batch(points).stats
    left, right = PointStats(), PointStats()
    for part in parts:
        left = left.merge(part)
    for part in reversed(parts):
        right = part.merge(right)
    mixed = PointStats()
    for i in data.draw(st.permutations(range(len(parts)))):
        mixed = parts[i].merge(mixed)
    assert left == right == mixed == whole
    assert whole.bad == any(part.bad for part in parts)


GOOD = PointStats(5, west=1.0, south=1.0, east=99.0, north=49.0, highest=20.0)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"points": 4}, "declares 5 points but holds 4"),
        ({"not_finite": 2, "first_not_finite": 3}, r"2 points .* not a number or infinite; the first is point 3"),
        ({"east": EARTH_LIMIT * 2}, "not a location on Earth"),
        ({"south": -EARTH_LIMIT * 2}, "not a location on Earth"),
        ({"highest": EARTH_LIMIT * 2}, "heights of up to 6e"),
        ({"outside": 2, "east": 120.0}, r"2 of 5 points are outside.*`trust_points=True`"),
        ({"points_outside_node": 3}, r"3 of 5 points .* octree.*`trust_points=True`"),
    ],
)
def test_the_verdict(changes, says, tmp_path):
    verify(GOOD, tmp_path, 5, BOX)
    record = GOOD.to_record() | changes
    with pytest.raises(BadInputError, match=says) as caught:
        verify(PointStats.from_record(record), tmp_path, 5, BOX)
    assert str(tmp_path) in str(caught.value)
    assert PointStats.from_record(record).bad == ("points" not in changes)
