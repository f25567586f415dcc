"""The filter method on whole scans: what a run loads, and the real scans of three sensors with nothing set."""

import math

import numpy as np
import pytest

from bumpymap.core import Scan, point_classes
from bumpymap.readers import read_scan
from bumpymap.scan import classify_filter, polar_sectors

REAL = [
    "monoforce/husky/1666877643_267394304.ply",
    "monoforce/husky_oru/1714571815_451803923.ply",
    "patchwork_128ch/000000.pcd",
]


def turned(scan, angle):
    c, s = math.cos(angle), math.sin(angle)
    return Scan((scan.points.astype(float) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])).astype(np.float32))


def classes(scan):
    return point_classes(scan, classify_filter(polar_sectors(scan)))


@pytest.mark.realdata
@pytest.mark.parametrize("name", REAL)
def test_a_real_scan_keeps_its_classes_when_it_turns(shared_data, name):
    scan = read_scan(shared_data / "scans" / name)
    before = classes(scan)
    assert len(set(before.tolist())) >= 3
    for angle in np.linspace(0.05, 6.2, 6):
        assert (classes(turned(scan, angle)) == before).mean() >= 0.97


@pytest.mark.realdata
@pytest.mark.parametrize("name", REAL)
def test_smooth_sectors_of_a_real_scan_hold_ground_and_nothing_tall(shared_data, name):
    scan = read_scan(shared_data / "scans" / name)
    classed = classify_filter(polar_sectors(scan))
    smooth = classed.class_id == 0
    assert smooth.sum() >= 8
    residual = classed.sectors.residual
    assert residual[smooth].mean() < 0.06
    assert np.abs(classed.sectors.point_height[classed.sectors.point_ground]).max() < 1.2
    # Over the plane of its sector, pixel by pixel.
    assert (np.abs(classed.sectors.heights[smooth]) > 0.5).mean() < 0.01
