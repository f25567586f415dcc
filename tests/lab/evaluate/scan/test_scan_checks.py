"""The driver for checks of scans: two scans of one place, turned scans, the plain way beside ours."""

from dataclasses import replace

import numpy as np
import pytest
from scan_checks import agreement, cell_classes, kept_share, plain_classes, scene_pairs, turn_scan

from bumpymap.core import ClassedSectors, Scan
from bumpymap.scan import classify_filter, load_stripes, polar_sectors


def _scan(seed):
    rng = np.random.default_rng(seed)
    return Scan(np.column_stack([rng.uniform(-40, 40, (200_000, 2)), rng.normal(-1.5, 0.01, 200_000)]).astype("f4"))


def _by_side(limit):
    """Class 0 where sectors lie to the right of ``limit`` m, 2 to the left of it, by the mean of their points."""

    def classify(scan):
        stack = polar_sectors(scan)
        inside = stack.point_sector >= 0
        mean = np.bincount(stack.point_sector[inside], scan.points[inside, 1]) / np.bincount(stack.point_sector[inside])
        return ClassedSectors(stack, np.where(mean > limit, 2, 0).astype(np.uint8), None, "learned")

    return classify


def test_cells_take_the_class_of_their_points():
    scan = _scan(1)
    cells = cell_classes(scan, _by_side(0.0)(scan)).reshape(120, 120)
    assert set(np.unique(cells)) == {-1, 0, 2}
    assert (cells[10:110, 70:90][cells[10:110, 70:90] >= 0] == 2).mean() > 0.9  # 5 to 15 m to the left
    assert (cells[10:110, 30:50][cells[10:110, 30:50] >= 0] == 0).mean() > 0.9
    x, y = np.meshgrid(*[np.arange(-29.75, 30, 0.5)] * 2, indexing="ij")
    assert (cells[np.hypot(x, y) > 30.5] == -1).all()


def test_cells_without_a_class_do_not_count():
    scan = _scan(1)
    classed = _by_side(0.0)(scan)
    barred = replace(classed, class_id=np.full_like(classed.class_id, 255))
    assert (cell_classes(scan, barred) == -1).all()


def test_agreement_is_whole_with_itself_and_falls_with_what_differs():
    pair = _scan(1), _scan(2)
    same = agreement(pair, _by_side(0.0))
    assert same.cells > 5000
    assert same.same / same.cells > 0.93  # cells on the margin of a sector differ

    def moved(scan):
        return _by_side(0.0 if scan is pair[0] else 10.0)(scan)

    other = agreement(pair, moved)
    assert other.cells == pytest.approx(same.cells, rel=0.05)
    assert 0.5 < other.same / other.cells < 0.85


@pytest.mark.open3d
def test_both_sensors_stand_at_one_place(monkeypatch):
    monkeypatch.setattr("bumpymap.lab.worlds.scans.ground.STEP", 0.04)
    (first, second), *more = list(scene_pairs(3, range(1)))
    assert not more
    assert len(first.points) > 1.3 * len(second.points)
    floors = [np.median(scan.points[np.hypot(*scan.points[:, :2].T) < 5, 2]) for scan in (first, second)]
    assert floors == pytest.approx([-1.7, -1.0], abs=0.3)


def ground(seed, rough=0.3):
    """A field that is smooth on the right and churned on the left, as (n, 4) rows of a .bin file."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-18, 18, (60_000, 2))
    z = -1.5 + rng.normal(0, 0.01, len(place)) + np.where(place[:, 1] > 0, rough * rng.uniform(-1, 1, len(place)), 0)
    return np.column_stack([place, z, np.zeros(len(place))]).astype("<f4")


@pytest.mark.slow
def test_a_turn_keeps_distances_and_comes_round():
    scan = Scan(ground(3)[:, :3])
    quarter = turn_scan(scan, np.pi / 2)
    assert quarter.points[:, 0] == pytest.approx(-scan.points[:, 1], abs=1e-5)
    assert quarter.points[:, 2] == pytest.approx(scan.points[:, 2])
    assert turn_scan(quarter, -np.pi / 2).points == pytest.approx(scan.points, abs=1e-5)


@pytest.mark.slow
def test_the_kept_share_tells_a_grid_that_stands_still():
    scan = Scan(ground(5)[:, :3])

    def by_compass(one):
        classed = classify_filter(polar_sectors(one))
        east = np.where(classed.sectors.sector % 2, 0, 2).astype(np.uint8)
        return type(classed)(classed.sectors, east, None, "filter")

    angles = [0.3, 1.0, 2.5]
    assert kept_share(scan, lambda one: classify_filter(polar_sectors(one)), angles) > 0.97
    standing = kept_share(scan, by_compass, [0.0])
    assert standing == 1.0
    assert np.isnan(kept_share(Scan(np.empty((0, 3), np.float32)), by_compass, angles))


@pytest.mark.slow
def test_the_plain_way_finds_much_the_same():
    scan = Scan(ground(6)[:, :3])
    sectors, classes = plain_classes(scan, load_stripes())
    ours = classify_filter(polar_sectors(scan))
    assert sectors == pytest.approx(len(ours.class_id), rel=0.05)
    plain = np.bincount(classes, minlength=3) / len(classes)
    shares = np.bincount(ours.class_id[ours.sectors.traversable], minlength=3) / ours.sectors.traversable.sum()
    assert plain == pytest.approx(shares, abs=0.25)
