"""Points that are thin_points, moved, and waited for."""

import numpy as np
import pytest
from _tile_trials import MOVES, density_sweep, invariance, library_terrains, measure_all, moved_points, thin_points

from bumpymap.core.config import FeatureSettings
from bumpymap.core.errors import BadInputError
from bumpymap.core.interrupts import SilentProgress
from bumpymap.lab.evaluate.rated_survey import load_survey, open_readers
from bumpymap.lab.simulate.ride_fit import survey_terrains
from bumpymap.lab.worlds.terrains import ScanEffects
from bumpymap.patches.features import join_stacks, measure
from bumpymap.readers import ReadOptions
from bumpytiles import Grid, TileBuckets

FEATURES = FeatureSettings()


def cloud(count=5000, seed=1):
    rng = np.random.default_rng(seed)
    buckets = TileBuckets(Grid())
    east, north = rng.uniform(500_000, 500_040, count), rng.uniform(-20, 20, count)
    buckets.add(east, north, rng.normal(size=count), rng.random(count) < 0.5)
    return buckets


def rows_of(points):
    return set(zip(points.easting.tolist(), points.northing.tolist(), points.upward.tolist(), strict=True))


def test_what_stays_at_a_density_stays_at_higher_ones():
    points = next(cloud().blocks())
    half, tenth = thin_points(points, 0.5, 3), thin_points(points, 0.1, 3)
    assert rows_of(tenth) < rows_of(half) < rows_of(points)
    assert len(half.easting) / len(points.easting) == pytest.approx(0.5, abs=0.05)
    assert np.array_equal(half.col, points.col)
    assert len(half.starts) == len(points.starts)
    assert half.starts[-1] == len(half.easting) == len(half.flag)


def test_points_stay_in_their_tile_when_thinned():
    points = thin_points(next(cloud().blocks()), 0.3, 3)
    owner = np.repeat(points.col, np.diff(points.starts))
    assert np.array_equal(points.grid.index(points.easting), owner)


def place(points):
    """Points from the middle of their tile."""
    count = np.diff(points.starts)
    east = points.easting - (np.repeat(points.col, count) + 0.5) * 3
    north = points.northing - (np.repeat(points.row, count) + 0.5) * 3
    return np.stack([east, north, points.upward])


def paired(points, moved):
    """Places before and after, matched by tile and height; heights are all different."""
    tile = [np.repeat(np.arange(len(own.col)), np.diff(own.starts)) for own in (points, moved)]
    orders = [np.lexsort((own.upward, number)) for own, number in zip((points, moved), tile, strict=True)]
    return place(points)[:, orders[0]], place(moved)[:, orders[1]]


def test_turning_and_mirroring_do_what_they_say():
    points = next(cloud().blocks())
    before, after = paired(points, moved_points(points, MOVES[0], 1))
    np.testing.assert_allclose(after, [-before[1], before[0], before[2]], atol=2e-6)
    before, after = paired(points, moved_points(points, MOVES[1], 1))
    np.testing.assert_allclose(after, [-before[0], before[1], before[2]], atol=2e-6)


def test_lifting_changes_heights_alone():
    points = next(cloud().blocks())
    before, after = paired(points, moved_points(points, MOVES[3], 1))
    np.testing.assert_allclose(after - before, np.broadcast_to([[0], [0], [1000]], before.shape), atol=2e-6)


def test_a_tilt_is_a_plane_of_ten_degrees_at_most():
    buckets = TileBuckets(Grid())
    rng = np.random.default_rng(4)
    east, north = rng.uniform(0, 48, (2, 20_000))
    buckets.add(east, north, np.zeros(20_000), np.zeros(20_000, bool))
    moved = moved_points(next(buckets.blocks()), MOVES[2], 1)
    slopes = []
    for begin, end in zip(moved.starts[:-1], moved.starts[1:], strict=True):
        own = slice(begin, end)
        x, y, z = moved.easting[own], moved.northing[own], moved.upward[own]
        terms = np.stack([x, y, np.ones(len(x))], axis=1)
        gradient, *_ = np.linalg.lstsq(terms, z, rcond=None)
        np.testing.assert_allclose(terms @ gradient, z, atol=1e-9)
        slopes.append(np.degrees(np.arctan(np.hypot(*gradient[:2]))))
    assert max(slopes) <= 10
    assert np.mean(slopes) == pytest.approx(5, abs=0.6)


def test_library_ground_keeps_its_class_when_it_is_moved(subject):
    terrains = library_terrains(subject.calibration, subject.profile, 5, 1)
    blocks = survey_terrains(terrains, ScanEffects(200, 0.01), 5).blocks()
    rows = invariance(blocks, stack_of_block, subject, 1)
    assert {(row.rating, row.move) for row in rows} == {(name, move) for name in ("ride", "table") for move in MOVES}
    for row in rows:
        assert row.tiles > 8
        assert row.same_class >= 0.8
        assert row.c_r_change < 0.1


def stack_of_block(points):
    return measure(points, FEATURES, ground_only=False)


def test_terrains_are_tiles_in_the_order_of_their_index(subject):
    terrains = library_terrains(subject.calibration, subject.profile, 5, 1) * 2
    patches = measure_all(survey_terrains(terrains, ScanEffects(300), 5), FEATURES)
    assert patches.col.tolist() == list(range(len(terrains)))
    for heights, terrain in zip(patches.heights, terrains, strict=True):
        assert np.nanmedian(np.abs(heights - terrain.heights)) < 0.05


@pytest.fixture
def readers(quarry):
    return open_readers([quarry], ReadOptions(), local=False)


def test_a_survey_gives_the_tiles_that_are_asked_for(readers, tmp_path):
    with load_survey(readers, "auto", Grid(), FEATURES, tmp_path, SilentProgress()) as survey:
        assert not survey.ground_only or survey.buckets.flagged_share() > 0.5
        every = join_stacks([survey.measured(points) for points in survey.points()])
        chosen = np.array([40, 3, 17])
        some = survey.patches(every.col[chosen], every.row[chosen])
    assert np.array_equal(some.heights, every.heights[chosen], equal_nan=True)
    assert list(tmp_path.iterdir()) == []


def test_points_that_a_killed_run_left_go_away(readers, tmp_path):
    (tmp_path / ".points").mkdir()
    (tmp_path / ".points" / "points-00000000-00000003.pack").write_text("half")
    with load_survey(readers, "all", Grid(), FEATURES, tmp_path, SilentProgress()) as survey:
        assert survey.blocks > 1
    assert list(tmp_path.iterdir()) == []


def test_points_that_find_no_room_wait_on_disk(readers, tmp_path, monkeypatch):
    def heights():
        with load_survey(readers, "all", Grid(), FEATURES, tmp_path, SilentProgress()) as survey:
            waiting = list(tmp_path.rglob("*.pack"))
            return waiting, join_stacks([survey.measured(points) for points in survey.points()]).heights

    none, at_once = heights()
    monkeypatch.setattr("bumpymap.lab.evaluate.rated_survey.MOST_BYTES", 280_000)
    monkeypatch.setattr("bumpymap.lab.evaluate.rated_survey.BLOCK_POINTS", 20_000)
    some, bit_by_bit = heights()
    assert not none
    assert some
    assert np.array_equal(at_once, bit_by_bit, equal_nan=True)


def test_a_survey_without_a_place_is_refused(tmp_path):
    import laspy

    path = tmp_path / "nowhere.las"
    las = laspy.create(point_format=0, file_version="1.2")
    las.x, las.y, las.z = np.zeros((3, 5))
    las.write(path)
    with pytest.raises(BadInputError, match="`local=True`"):
        open_readers([path], ReadOptions(), local=False)
    with (
        pytest.raises(BadInputError, match="class 2"),
        load_survey(
            open_readers([path], ReadOptions(), local=True), "class", Grid(), FEATURES, tmp_path, SilentProgress()
        ),
    ):
        pass


def test_thinning_loses_classes_and_confidence_bit_by_bit(readers, tmp_path, subject):
    with load_survey(readers, "all", Grid(), FEATURES, tmp_path, SilentProgress()) as survey:
        rows = density_sweep(survey, subject, 97.0, (200.0, 60.0, 12.0), 1, SilentProgress())
        again = density_sweep(survey, subject, 97.0, (12.0,), 1, SilentProgress())
    assert [(row.rating, row.density) for row in rows] == [
        (name, d) for d in (60.0, 12.0) for name in ("ride", "table")
    ]
    assert [row for row in rows if row.density == 12] == again
    for name in ("ride", "table"):
        many, few = (row for row in rows if row.rating == name)
        assert many.same_class >= few.same_class > 0.4
        assert many.still_judged >= few.still_judged
        assert few.confidence_moved < few.confidence_kept
