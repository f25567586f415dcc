"""Ground under vegetation: the cloth finds what lies under the trees, the same for the same points."""

import importlib.util

import numpy as np
import pytest
import small_surveys
from patch_stacks import block_of
from small_surveys import alike_surveys, band, layers_of, write_las

from bumpymap.core import OBSTACLE, Barred, CsfSettings, UsageError, install_command
from bumpymap.patches import close_filter, cloth, mark_ground, require_filter
from bumpymap.survey import Budget
from bumpytiles import Grid

pytestmark = pytest.mark.usefixtures("without_views")

needs_filter = pytest.mark.skipif(importlib.util.find_spec("CSF") is None, reason="no cloth-simulation-filter")
CORNER = np.array([480_000.0, 4_000_032.0, 300.0])
"""Of a block."""


@pytest.fixture(autouse=True)
def _rested():
    yield
    close_filter()


@pytest.fixture(scope="module")
def wood():
    """Points of 96 m x 48 m on a grid of 1 / 1024 m, and which of them are ground.

    Rough in the east half, under crowns that begin 3 m above the ground, in every other strip of 12 m.
    """
    rng = np.random.default_rng(5)
    n = 160_000
    x, y = rng.uniform(0.01, 95.99, n), rng.uniform(0.01, 47.99, n)
    ground = 0.03 * x + 0.16 * np.sin(4 * x) * np.sin(5 * y) * (x > 48) + 0.004 * rng.normal(size=n)
    crown = (x // 12 % 2 == 1) & (rng.random(n) < 0.4)
    z = ground + crown * rng.uniform(3, 9, n)
    return np.round(np.column_stack([x, y, z]) * 1024) / 1024, ~crown


def write(path, points):
    return write_las(path, *(points + CORNER).T, offset=CORNER, scales=np.full(3, 1 / 1024))


def run(*arguments, code=0):
    with alike_surveys():
        return small_surveys.run(*arguments, code=code)


@pytest.fixture(scope="module")
def mapped(wood, tmp_path_factory):
    """Folder of the layers of the wood that the cloth gives."""
    folder = tmp_path_factory.mktemp("wood")
    survey = write(folder / "wood.las", wood[0])
    run("map", survey, "--ground", "csf", "--out", folder / "csf")
    return folder


def standing(folder):
    """Where obstacles are, by tile and pixel."""
    pixels = band(folder / "rasters/obstacle.tif") == OBSTACLE
    return pixels.reshape(len(pixels) // 15, 15, -1, 15).swapaxes(1, 2)


@needs_filter
def test_the_map_under_trees_is_that_of_the_ground_alone(wood, mapped):
    points, is_ground = wood
    alone = write(mapped / "ground.las", points[is_ground])
    for survey, name in ((alone, "alone"), (mapped / "wood.las", "everything")):
        run("map", survey, "--ground", "all", "--out", mapped / name)
    class_id, wanted = (band(mapped / name / "rasters/class.tif") for name in ("csf", "alone"))
    c_r, wanted_c_r = (band(mapped / name / "rasters/roughness.tif", "c_r") for name in ("csf", "alone"))
    assert class_id.shape == (16, 32)
    np.testing.assert_array_equal(class_id, wanted)
    # Without other points, a narrow hump of the ground may be a thing that the ride is rated without.
    bare = ~standing(mapped / "alone").any(axis=(2, 3))
    assert bare.mean() > 0.9
    np.testing.assert_allclose(c_r[bare], wanted_c_r[bare], rtol=5e-3)  # the noise of thin tiles is that of all
    assert set(np.unique(wanted)) >= {0, 2}  # nothing would be held were it all of one class
    # Crowns are part of the relief where nobody takes them away: what stands out of it bars the way.
    assert (band(mapped / "everything/rasters/barred.tif")[:, 4:8] != Barred.NO).all()
    assert standing(mapped / "everything")[:, 4:8].mean() > 0.5
    assert (wanted[:, 4:8] == 0).all()


@pytest.mark.slow
@needs_filter
def test_no_order_of_the_points_and_no_budget_changes_a_byte(wood, mapped, tmp_path, monkeypatch):
    survey = write(tmp_path / "other.laz", np.random.default_rng(3).permutation(wood[0]))
    monkeypatch.setattr(Budget, "chunk_points", 9_000)
    monkeypatch.setattr(Budget, "waiting_points", 30_000)
    run("map", survey, "--ground", "csf", "--out", tmp_path / "csf", "--threads", 3)
    assert layers_of(tmp_path / "csf") == layers_of(mapped / "csf")


@needs_filter
def test_neither_the_environment_nor_the_place_on_earth_changes_a_mark(wood, monkeypatch):
    """With more than one thread the filter gives other marks each time; both places are exact in binary."""
    points = wood[0].copy()
    points[:, 2] += np.random.default_rng(1).exponential(1.0, len(points))  # bushes, so that marks are in doubt
    points = np.round(points * 1024) / 1024

    def marks(place):
        block = block_of(*(points + place).T)
        there = np.column_stack([block.easting, block.northing, block.upward]) - place
        return np.column_stack([there, mark_ground(block, CsfSettings())])[np.lexsort(there.T)]

    expected = marks(np.zeros(3))
    np.testing.assert_array_equal(marks(CORNER), expected)
    for threads in ("1", "4"):
        close_filter()
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        for _ in range(2):
            np.testing.assert_array_equal(marks(np.zeros(3)), expected)


@needs_filter
def test_settings_reach_the_filter(wood):
    """A cloth that marks all within 20 m leaves nothing out; one of 1 cm leaves out what waves rise above it."""
    block = block_of(*wood[0].T)
    everything = mark_ground(block, CsfSettings(class_threshold=10.0))
    usual, little = (mark_ground(block, CsfSettings(class_threshold=limit)) for limit in (0.5, 0.01))
    assert everything.all()
    assert little.sum() < 0.5 * usual.sum()
    assert (usual | ~little).all()


@needs_filter
def test_a_block_may_hold_next_to_nothing():
    for points in (1, 2, 3):
        marks = mark_ground(block_of(*np.arange(3.0 * points).reshape(-1, 3).T), CsfSettings())
        assert marks.shape == (points,)
        assert marks.any()


@needs_filter
def test_a_filter_that_died_is_told_and_replaced(wood):
    block = block_of(*wood[0].T)
    marks = mark_ground(block, CsfSettings())
    (child,) = cloth.idle
    child.process.kill()
    child.process.wait()
    with pytest.raises(UsageError, match=r"was ended by SIGKILL.*lower `memory`"):
        mark_ground(block, CsfSettings())
    np.testing.assert_array_equal(mark_ground(block, CsfSettings()), marks)


@needs_filter
def test_a_boulder_goes_as_a_tree_does_and_is_an_obstacle(tmp_path):
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0.01, 47.99, (2, 150_000))
    far = np.hypot(x - 22.5, y - 22.5) / 0.5
    points = np.column_stack([x, y, 2.0 * np.sqrt(np.maximum(0, 1 - far**2)) + 0.004 * rng.normal(size=len(x))])
    survey = write(tmp_path / "boulder.las", np.round(points * 1024) / 1024)
    for ground in ("all", "csf"):
        run("map", survey, "--ground", ground, "--out", tmp_path / ground)
        assert standing(tmp_path / ground)[8, 7].mean() == pytest.approx(np.pi * 0.5**2 / 9, rel=0.3)
        assert band(tmp_path / ground / "rasters/class.tif")[8, 7] <= 1  # the ride is that of the ground beside it
    obstacle, height = (band(tmp_path / "csf/rasters/roughness.tif", name) for name in ("obstacle", "obstacle_height"))
    assert obstacle[8, 7] == pytest.approx(np.pi * 0.5**2 / 9, rel=0.2)  # its top too, which is higher than the vehicle
    assert height[8, 7] == pytest.approx(1.38, abs=0.1)  # up to that of the vehicle


@needs_filter
def test_blocks_that_would_be_shared_out_or_are_too_large_for_the_cloth_are_refused(mapped, tmp_path, monkeypatch):
    monkeypatch.setattr(Budget, "block_points", 50_000)
    result = run("map", mapped / "wood.las", "--ground", "csf", "--out", tmp_path / "csf", code=2)
    assert "--ground csf takes squares of 48 m as a whole" in result.output
    assert "room for 50,000. Raise --memory" in result.output
    require_filter(CsfSettings(), Grid(15.0))
    with pytest.raises(UsageError, match=r"blocks are 320 m wide, it must be at least 0.64 m"):
        require_filter(CsfSettings(), Grid(20.0))


def test_without_the_filter_the_user_is_told_what_to_install(wood, tmp_path, monkeypatch):
    monkeypatch.setattr(cloth.importlib.util, "find_spec", lambda _: None)
    survey = write(tmp_path / "wood.las", wood[0][:5000])
    assert install_command("csf") in run("map", survey, "--ground", "csf", "--out", tmp_path / "csf", code=2).output
    assert not (tmp_path / "csf").exists()
