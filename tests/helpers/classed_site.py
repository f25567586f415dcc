from dataclasses import replace

import numpy as np
import pytest

from bumpymap.core import Scan, sector_bounds
from bumpymap.scan import classify_filter, polar_sectors


def site(count=40_000, far=27.0, seed=0):
    """Points around a sensor 1.5 m above ground: smooth left, rubble right, a wall ahead, a crown behind."""
    rng = np.random.default_rng(seed)
    radius, azimuth = np.sqrt(rng.uniform(1.0, far**2, count)), rng.uniform(-np.pi, np.pi, count)
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    z = -1.5 + np.where(y < 0.0, 0.15 * rng.standard_normal(count), 0.003 * rng.standard_normal(count))
    wall = (x > 14.0) & (x < 19.0) & (np.abs(y) < 6.0)
    x, z = np.where(wall, 14.0 + 0.01 * rng.standard_normal(count), x), np.where(wall, rng.uniform(-1.5, 1.5, count), z)
    z = np.where((x < -14.0) & (x > -20.0) & (np.abs(y) < 6.0), rng.uniform(2.5, 6.0, count), z)
    return np.column_stack([x, y, z]).astype(np.float32)


@pytest.fixture(name="scan", scope="session")
def scan_fixture():
    points = site()
    rng = np.random.default_rng(1)
    label = np.where(points[:, 1] < 0.0, 34, 3).astype(np.uint16)
    return Scan(points, rng.uniform(0.0, 1.0, len(points)).astype(np.float32), label, "site")


@pytest.fixture(name="classed", scope="session")
def classed_fixture(scan):
    """Classes of all kinds, whatever the method makes of the rubble."""
    classed = classify_filter(polar_sectors(scan))
    bounds = sector_bounds(classed.sectors)
    left = (bounds.right + bounds.left) / 2.0 % (2.0 * np.pi) < np.pi
    class_id = np.where(classed.sectors.traversable, np.where(left, 0, 2), 255).astype(np.uint8)
    class_id[np.flatnonzero(class_id == 0)[::3]] = 1
    assert np.unique(class_id).tolist() == [0, 1, 2, 255]
    return replace(classed, class_id=class_id)


@pytest.fixture(name="nothing", scope="session")
def nothing_fixture():
    scan = Scan(np.zeros((0, 3), np.float32), name="nothing")
    return scan, classify_filter(polar_sectors(scan))
