"""The LiDAR against closed forms: level ground, tilt, grass, lost returns; and its files."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bumpymap.lab.worlds.scans import ground
from bumpymap.lab.worlds.scans.ground import Blob
from bumpymap.lab.worlds.scans.lidar import SENSORS, Sensor, simulate_scan
from bumpymap.lab.worlds.scans.scene import Scene, make_scene
from bumpymap.lab.worlds.scans.things import Label

pytestmark = pytest.mark.slow

SMALL = Sensor(lines=16, columns=128, end_m=25.0)
PERFECT = replace(SMALL, noise_m=0.0, lost=0.0, reach_m=1000.0)


@pytest.fixture(autouse=True)
def _coarse_mesh(monkeypatch):
    monkeypatch.setattr(ground, "STEP", 0.04)


@pytest.fixture(scope="module")
def level():
    made = replace(make_scene(1, 0).ground, regions=(), hills_m=0.0, bumps_m=0.0, slope=(0.0, 0.0), banks=())
    made = replace(made, cover_rough_m=0.0, cover=Label.DIRT, grass_m=0.3)
    return Scene("level", made, ())


@pytest.mark.open3d
def test_the_seed_decides_every_bit():
    scene = make_scene(2, 4)
    one, two, other = (simulate_scan(scene, SMALL, seed) for seed in (1, 1, 2))
    for name in ("points", "intensity", "label"):
        assert_array_equal(getattr(one, name), getattr(two, name))
    assert (one.points != other.points).any()


@pytest.mark.open3d
def test_level_ground_is_met_where_the_height_says(level):
    scan = simulate_scan(level, PERFECT, 1)
    seen = scan.label > 0
    elevation = np.repeat(np.radians(np.linspace(-22.5, 22.5, 16)), 128)
    assert_array_equal(seen, (elevation < 0) & (1.4 / np.sin(-np.minimum(elevation, -1e-9)) < 25.0))
    assert_allclose(scan.points[seen, 2], -1.4, atol=1e-4)
    assert (scan.label[seen] == Label.DIRT).all()
    assert_array_equal(scan.points[~seen], 0.0)
    assert_array_equal(scan.intensity[~seen], 0.0)


@pytest.mark.open3d
def test_a_tilted_sensor_sees_tilted_ground(level):
    tilted = replace(PERFECT, tilt_deg=(3.0, -5.0))
    scan = simulate_scan(level, tilted, 1)
    upright = scan.points[scan.label > 0] @ tilted.to_level().T
    assert_allclose(upright[:, 2], -1.4, atol=1e-4)
    # Nose up (negative pitch about y), the ground ahead lies lower in the sensor's own frame.
    ahead = scan.points[(scan.label > 0) & (scan.points[:, 0] > 4) & (np.abs(scan.points[:, 1]) < 1)]
    assert (ahead[:, 2] < -1.4).all()


@pytest.mark.open3d
def test_range_noise_is_as_large_as_said(level):
    noisy = simulate_scan(level, replace(PERFECT, noise_m=0.03, columns=512), 1)
    clean = simulate_scan(level, replace(PERFECT, columns=512), 1)
    seen = clean.label > 0
    error = np.linalg.norm(noisy.points[seen], axis=1) - np.linalg.norm(clean.points[seen], axis=1)
    assert error.std() == pytest.approx(0.03, rel=0.1)
    assert abs(error.mean()) < 0.005


@pytest.mark.open3d
def test_grass_stops_beams_above_the_soil_and_never_above_itself(level):
    meadow = replace(level, ground=replace(level.ground, cover=Label.GRASS))
    scan = simulate_scan(meadow, PERFECT, 1)
    above = scan.points[scan.label > 0, 2] + 1.4
    assert above.min() > -1e-3
    assert above.max() < 2.5 * 0.3 + 1e-3
    assert above.std() > 0.02
    thin = replace(meadow, ground=replace(meadow.ground, grass_path_m=1e6))
    assert np.abs(simulate_scan(thin, PERFECT, 1).points[scan.label > 0, 2] + 1.4).max() < 1e-3


@pytest.mark.open3d
def test_returns_fade_with_distance_and_water_throws_them_away(level):
    sensor = replace(SMALL, lines=64, lowest_deg=-30, highest_deg=-2, reach_m=12.0, lost=0.0)
    scan = simulate_scan(level, sensor, 1)
    share = (scan.label > 0).reshape(64, 128).mean(axis=1)
    assert share[:8].mean() > 0.9  # down to 2.8 m away
    assert share[-8:].mean() < 0.3  # 15 m and more
    pond = Blob(Label.WATER, (0.0, 0.0), 200.0, (), 0.0, 0.0)
    wet = replace(level, ground=replace(level.ground, regions=(pond,)))
    assert (simulate_scan(wet, sensor, 1).label > 0).sum() < 0.6 * (scan.label > 0).sum()


@pytest.mark.open3d
def test_what_stands_in_the_way_hides_what_lies_behind(level):
    wall = np.array([[[5, -2, -1], [5, 2, -1], [5, 2, 3]], [[5, -2, -1], [5, 2, 3], [5, -2, 3]]], np.float32)
    scan = simulate_scan(replace(level, things=((Label.BARRIER, wall),)), PERFECT, 1)
    ahead = (np.abs(scan.points[:, 1]) < 0.35 * scan.points[:, 0]) & (scan.label > 0)
    assert_allclose(scan.points[ahead & (scan.label == Label.BARRIER), 0], 5.0, atol=1e-3)
    assert scan.points[ahead, 0].max() < 5.001
    assert (scan.label[ahead] == Label.BARRIER).any()


def test_a_solid_state_sensor_looks_ahead_and_its_loops_pass_the_middle():
    sensor = SENSORS["rosette_80"]
    rays = sensor.directions()
    azimuth, elevation = np.degrees(np.arctan2(rays[:, 1], rays[:, 0])), np.degrees(np.arcsin(rays[:, 2]))
    assert ((azimuth / 40) ** 2 + (elevation / 35) ** 2).max() <= 1 + 1e-9
    assert np.abs(azimuth).max() > 39
    assert np.abs(elevation).max() > 34
    middle = np.hypot(azimuth, elevation) < 4
    assert np.count_nonzero(np.diff(middle.astype(int)) == 1) >= 50  # sixty loops
    raster = SENSORS["raster_120"].directions()
    assert np.degrees(np.abs(np.arctan2(raster[:, 1], raster[:, 0]))).max() == pytest.approx(60)
    whole = SENSORS["rosette_360"].directions()
    turned = np.histogram(np.arctan2(whole[:, 1], whole[:, 0]), 36, (-np.pi, np.pi))[0]
    assert turned.min() > 0.5 * turned.mean()


@pytest.mark.open3d
@pytest.mark.parametrize("slope", [(0.0, -0.3), (0.2, 0.2)])
def test_a_robot_leans_with_its_ground(level, slope):
    scan = simulate_scan(replace(level, ground=replace(level.ground, slope=slope)), PERFECT, 1)
    away = np.hypot(scan.points[:, 0], scan.points[:, 1])
    seen = (scan.label > 0) & (away < 15)
    assert_allclose(scan.points[seen, 2], scan.points[seen, 2].mean(), atol=2e-3)


@pytest.mark.open3d
def test_a_mirror_image_is_as_far_below_the_ground_as_its_object_is_above(level):
    wall = np.array([[[8, -9, -1], [8, 9, -1], [8, 9, 6]], [[8, -9, -1], [8, 9, 6], [8, -9, 6]]], np.float32)
    pool = Blob(Label.WATER, (0.0, 0.0), 200.0, (), 0.0, 0.0)
    pond = replace(level, ground=replace(level.ground, regions=(pool,)), things=((Label.BARRIER, wall),))
    sensor = replace(PERFECT, lines=64, columns=512)
    assert (simulate_scan(pond, sensor, 1).points[:, 2] > -1.4 - 1e-3).all()
    scan = simulate_scan(replace(pond, mirror=1.0), sensor, 1)
    image = scan.points[:, 2] < -1.5
    assert image.sum() > 50
    assert (scan.label[image] == 0).all()
    assert_allclose(scan.points[image, 0], 8.0, atol=0.05)  # behind the surface of the pond, straight below the wall
    assert scan.points[image, 2].min() > -1.4 - 6.0


def test_open3d_stays_out_until_it_is_needed():
    import subprocess
    import sys

    code = "import bumpymap.lab.worlds.scans, sys; print('open3d' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"
