"""ransac_residual against two other implementations, on the sample survey and on a real one."""

from pathlib import Path

import laspy
import numpy as np
import pytest
from sklearn.linear_model import RANSACRegressor

THRESHOLD = 0.1
TILES = 60


def tiles_of(path, measure_points):
    """Local points and our residual of some dense tiles from the middle of a survey."""
    las = laspy.read(path)
    x, y, z = (np.asarray(axis) for axis in (las.x, las.y, las.z))
    near = (abs(x - np.median(x)) < 36) & (abs(y - np.median(y)) < 36)
    x, y, z = x[near], y[near], z[near]
    stack = measure_points(x, y, z)
    dense = np.flatnonzero(stack.count > 200)
    col, row = np.floor(x / 3), np.floor(y / 3)
    for k in np.random.default_rng(0).choice(dense, TILES, replace=False):
        mine = (col == stack.col[k]) & (row == stack.row[k])
        points = np.column_stack((x[mine] - 3 * stack.col[k], y[mine] - 3 * stack.row[k], z[mine] - z[mine].mean()))
        yield points, stack.ransac_residual[k]


def by_sklearn(points):
    fit = RANSACRegressor(residual_threshold=THRESHOLD, random_state=0, max_trials=1000).fit(
        points[:, :2], points[:, 2]
    )
    across = np.sqrt(1 + np.sum(fit.estimator_.coef_**2))
    return np.mean(np.abs(points[:, 2] - fit.predict(points[:, :2]))) / across


def by_open3d(points):
    import open3d

    open3d.utility.random.seed(0)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    plane, _ = cloud.segment_plane(THRESHOLD, 3, 1000, probability=1.0)
    return np.mean(np.abs(points @ plane[:3] + plane[3]))


ORACLES = [by_sklearn, pytest.param(by_open3d, marks=pytest.mark.open3d)]


@pytest.mark.parametrize("oracle", ORACLES)
def test_residuals_of_the_sample_survey(oracle, measure_points):
    quarry = Path(__file__).resolve().parents[2] / "sample_data" / "quarry.laz"
    agree_in_the_median(tiles_of(quarry, measure_points), oracle)


@pytest.mark.realdata
@pytest.mark.parametrize("oracle", ORACLES)
def test_residuals_of_a_real_survey(oracle, measure_points, shared_data):
    agree_in_the_median(tiles_of(shared_data / "surveys" / "godie_espacio.laz", measure_points), oracle)


def agree_in_the_median(tiles, oracle):
    ratio = np.array([ours / oracle(points) for points, ours in tiles])
    assert len(ratio) == TILES
    assert np.median(ratio) == pytest.approx(1.0, abs=0.05)
    assert np.median(np.abs(ratio - 1.0)) < 0.05
