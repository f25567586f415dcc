"""Scores of ground and obstacles, against points counted by hand."""

from dataclasses import replace

import numpy as np
import pytest

from bumpymap.core import ClassedSectors, Scan
from bumpymap.lab import LABEL_SETS
from bumpymap.lab.evaluate.scans import ground_score, mean_ground, obstacle_score
from bumpymap.scan import polar_sectors

KITTI = LABEL_SETS["kitti"]
ROAD, FENCE, NONE, OTHER = 9, 14, 0, 77


def _scan(away, label):
    points = np.zeros((len(away), 3), np.float32)
    points[:, 0] = away
    return Scan(points, label=np.array(label, np.uint16), name="one")


def test_ground_is_counted_between_4_and_80_m_where_points_have_a_label():
    scan = _scan([5, 6, 7, 8, 9, 10, 3, 81], [ROAD, ROAD, ROAD, FENCE, NONE, OTHER, ROAD, ROAD])
    found = np.array([True, True, False, True, True, True, True, True])
    score = ground_score(scan, found, KITTI)
    assert (score["frame"], score["points"]) == ("one", 4)
    assert (score["precision"], score["recall"], score["f1"]) == pytest.approx((2 / 3, 2 / 3, 2 / 3))


def test_nothing_found_has_no_precision_and_a_frame_without_ground_no_part_in_the_mean():
    scan = _scan([5, 6], [ROAD, FENCE])
    score = ground_score(scan, np.zeros(2, np.bool_), KITTI)
    assert np.isnan(score["precision"])
    assert (score["recall"], score["f1"]) == (0.0, 0.0)
    bare = ground_score(_scan([5], [FENCE]), np.zeros(1, np.bool_), KITTI)
    good = {"frame": "two", "points": 10, "precision": 1.0, "recall": 0.5, "f1": 0.8}
    mean = {"frame": "mean", "points": 12, "precision": 1.0, "recall": 0.25, "f1": 0.4}
    assert mean_ground([score, good, bare]) == mean
    assert np.isnan(mean_ground([bare])["f1"])


def test_points_of_obstacles_are_looked_for_in_free_sectors():
    # Four sectors: smooth, smooth with an obstacle, rough, without ground; a fence point in each and in none.
    scan = _scan([5, 5, 5, 5, 5, 5, 3, 5], [FENCE] * 7 + [ROAD])
    rng = np.random.default_rng(1)
    around = np.column_stack([rng.uniform(-12, 12, (20_000, 2)), np.zeros(20_000)]).astype(np.float32)
    full = polar_sectors(Scan(around))
    rows = {
        name: getattr(full, name)[:4]
        for name in full.__slots__
        if isinstance(getattr(full, name), np.ndarray) and not name.startswith("point_")
    }
    rows["obstacle"] = np.array([False, True, False, False])
    stack = replace(
        polar_sectors(Scan(np.zeros((0, 3), np.float32))),
        **rows,
        point_ground=np.zeros(8, np.bool_),
        point_sector=np.array([0, 0, 1, 2, 3, -1, 0, 0], np.int32),
        point_height=np.array([0.5, 3.0, 0.5, 0.5, np.nan, np.nan, 0.5, 0.0], np.float32),
    )
    classed = ClassedSectors(stack, np.array([0, 1, 2, 255], np.uint8), None, "learned")
    score = obstacle_score(scan, classed, KITTI)
    assert score == {"points": 6, "in_free": 2, "in_free_low": 1, "in_free_class": 3}
