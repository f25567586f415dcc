import numpy as np
import pytest

from bumpymap.lab.worlds.sample import NOISE_POINTS, NOISE_SIGMA, STRAYS, WITHHELD_POINTS, QuarrySite, sample_survey
from bumpytiles import Bounds

SITE = QuarrySite(1)
AREA = Bounds(512_370.0, 5_403_230.0, 512_400.0, 5_403_290.0)


@pytest.fixture(scope="module")
def points():
    return sample_survey(SITE, density=20.0)


def test_heights_are_the_reliefs_within_the_noise(points):
    ground = points.is_true_ground
    error = points.upward[ground] - SITE.height(points.easting[ground], points.northing[ground])
    assert abs(error.mean()) < 5.0 * NOISE_SIGMA / np.sqrt(error.size)
    assert error.std() == pytest.approx(NOISE_SIGMA, rel=0.01)
    assert np.abs(error).max() < 6.0 * NOISE_SIGMA


def test_errors_are_counted_and_far_from_the_ground(points):
    off = points.upward - SITE.height(points.easting, points.northing)
    assert points.is_stray.sum() == STRAYS
    assert np.count_nonzero(off[points.is_stray] > 15.0) == 5
    assert np.count_nonzero(off[points.is_stray] < -10.0) == STRAYS - 5
    assert set(points.classification[points.is_stray].tolist()) == {1, 2}
    assert not points.withheld[points.is_stray].any()
    assert np.count_nonzero(points.classification == 7) == NOISE_POINTS
    assert np.abs(off[points.classification == 7]).min() > 2.9
    assert points.withheld.sum() == WITHHELD_POINTS
    assert np.abs(off[points.withheld]).min() > 0.25


def test_class_counts_add_up(points):
    ground, trees = (np.count_nonzero(points.classification == code) for code in (2, 5))
    strays_of_class_1 = np.count_nonzero(points.classification == 1)
    assert strays_of_class_1 == STRAYS // 2
    assert ground + trees + strays_of_class_1 + NOISE_POINTS == points.easting.size
    assert 0.01 < trees / points.easting.size < 0.03


def test_trees_stand_over_thinner_ground(points):
    tree = SITE.trees[0]
    under = np.hypot(points.easting - tree.easting, points.northing - tree.northing) < tree.radius * 0.99
    canopy = under & (points.classification == 5)
    above = points.upward[canopy] - SITE.height(np.array(tree.easting), np.array(tree.northing))
    assert np.count_nonzero(canopy) > np.count_nonzero(under & points.is_true_ground) > 0
    assert above.min() > 0.0
    assert above.max() <= tree.height + 1e-3


def test_pond_is_the_only_hole(points):
    assert not SITE.is_water(points.easting, points.northing).any()
    assert not np.any(SITE.zone_at(points.easting, points.northing) == "pond")
    box = SITE.bounds
    edges = (np.arange(box.west + 3.0, box.east - 2.9, 3.0), np.arange(box.south + 3.0, box.north - 2.9, 3.0))
    counts, _, _ = np.histogram2d(points.easting, points.northing, bins=edges)
    centre_east, centre_north = np.meshgrid(edges[0][:-1] + 1.5, edges[1][:-1] + 1.5, indexing="ij")
    empty = counts == 0
    assert empty.any()
    assert SITE.is_water(centre_east[empty], centre_north[empty]).all()


def test_density_is_the_one_asked_for_and_uneven(points):
    box = SITE.bounds
    area = (box.east - box.west) * (box.north - box.south)
    assert points.easting.size / area == pytest.approx(20.0, rel=0.05)
    counts, _, _ = np.histogram2d(points.easting, points.northing, bins=(14, 11))
    sparse, dense = np.quantile(counts[1:-1, 1:-1], (0.1, 0.9))
    assert dense > 1.4 * sparse


def test_points_come_in_flight_order(points):
    assert np.all(np.diff(points.gps_time) > 0.0)
    assert np.unique(points.line).tolist() == [1, 2, 3, 4, 5, 6]
    first, second = (points.easting[points.line == line] for line in (1, 2))
    assert first[0] < first[-1]
    assert second[0] > second[-1]
    assert np.any(np.diff(points.northing) > 0)
    assert np.any(np.diff(points.northing) < 0)


def test_a_part_holds_the_ground_points_of_the_whole(points):
    part = sample_survey(SITE, density=20.0, area=AREA)
    inside = (points.easting >= AREA.west) & (points.easting < AREA.east)
    inside &= (points.northing >= AREA.south) & (points.northing < AREA.north)
    whole = points.select(inside)
    assert np.array_equal(part.easting, whole.easting)
    assert np.array_equal(part.northing, whole.northing)
    both = part.is_true_ground & whole.is_true_ground
    assert both.sum() > 0.95 * both.size
    assert np.array_equal(part.upward[both], whole.upward[both])


def test_too_few_points_and_bad_density_are_refused():
    with pytest.raises(ValueError, match="raise the density"):
        sample_survey(SITE, density=0.05)
    with pytest.raises(ValueError, match="density is"):
        sample_survey(SITE, density=float("nan"))
