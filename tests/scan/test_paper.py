"""The paper's own rules: bounding boxes, black holes, classes found anew in every scan."""

import math

import numpy as np
import pytest

from bumpymap.core import NOT_TRAVERSABLE, PolarSettings, Scan
from bumpymap.scan import polar_sectors
from bumpymap.scan.methods import classify_paper, paper_heights, paper_settings


def made_scan(seed=1, bumps=0.2, count=30_000):
    rng = np.random.default_rng(seed)
    r, turn = 4.0 + 20.0 * rng.random(count), 2 * np.pi * rng.random(count)
    z = -1.5 + bumps * (turn > np.pi) * rng.standard_normal(count)
    return Scan(np.column_stack([r * np.cos(turn), r * np.sin(turn), z]).astype(np.float32))


def test_heightmaps_are_those_of_a_loop_by_hand():
    scan = made_scan()
    stack = polar_sectors(scan, paper_settings(PolarSettings()))
    maps = paper_heights(scan, stack)
    for row in range(0, len(stack.zone), 7):
        points = scan.points[stack.point_sector == row].astype(float)
        x, y, z = points.T
        columns = np.minimum(15 * (x - x.min()) / np.ptp(x), 14).astype(int)
        rows = 14 - np.minimum(15 * (y - y.min()) / np.ptp(y), 14).astype(int)
        expected = np.full((15, 15), np.nan)
        for r, c in set(zip(rows.tolist(), columns.tolist(), strict=True)):
            expected[r, c] = z[(rows == r) & (columns == c)].mean()
        expected -= np.nanmin(expected)
        top = np.nanmax(expected)
        np.testing.assert_allclose(maps[row], np.nan_to_num(expected / (top or 1.0)), atol=1e-6)


def test_classes_fall_in_stripes_on_a_grid_that_stands_still():
    scan = made_scan()
    classed = classify_paper(scan)
    assert classed.sectors.azimuth_start_rad == 0.0
    assert math.isinf(classed.sectors.settings.overhead_m)
    counts = [classed.stripes[classed.class_id == class_id] for class_id in range(3)]
    assert counts[0].min() > counts[1].max()
    assert counts[1].min() > counts[2].max()
    assert (classed.class_id[~classed.sectors.traversable] == NOT_TRAVERSABLE).all()
    np.testing.assert_array_equal(classed.class_id, classify_paper(scan).class_id)


@pytest.mark.parametrize("sectors", [0, 1, 2])
def test_a_scan_of_fewer_than_three_counts_has_as_many_classes(sectors):
    rng = np.random.default_rng(4)
    parts = [np.empty((0, 3))]
    for place in range(sectors):
        turn = math.radians(15 * place) + np.radians(rng.uniform(1, 14, 60))
        r = rng.uniform(4.1, 5.9, 60)
        parts.append(np.column_stack([r * np.cos(turn), r * np.sin(turn), -1.5 + 0.01 * rng.standard_normal(60)]))
    classed = classify_paper(Scan(np.concatenate(parts).astype(np.float32)))
    assert classed.sectors.traversable.tolist() == [True] * sectors
    different = np.unique(classed.stripes)
    assert sorted(classed.class_id.tolist()) == list(range(len(different)))
    assert (np.diff(classed.class_id[np.argsort(classed.stripes)].astype(int)) < 0).all()
