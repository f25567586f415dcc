"""The polar grid against a loop over sectors written with numpy alone, and its properties."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from bumpymap.core import NOT_TRAVERSABLE, PolarSettings, Scan, point_classes
from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.scan import classify_filter, polar_sectors
from bumpymap.scan.polar import anchor_of

FIXED = PolarSettings(anchored=False)


def made_scan(seed, count=40_000, labels=False):
    """Bumpy ground on a slope, denser near the sensor, with a few posts and points outside the grid."""
    rng = np.random.default_rng(seed)
    r = 2.0 + 110.0 * rng.random(count) ** 2.5
    turn = 2.0 * np.pi * rng.beta(2.0, 3.0, count)
    x, y = r * np.cos(turn), r * np.sin(turn)
    z = 0.08 * x - 1.5 + 0.05 * np.sin(2.0 * x) * np.cos(1.5 * y) + 0.01 * rng.standard_normal(count)
    z += np.where(rng.random(count) < 0.1 * (turn < 1.0), 3.0 * rng.random(count), 0.0)
    label = rng.integers(1, 5, count).astype(np.uint16) if labels else None
    return Scan(np.column_stack([x, y, z]).astype(np.float32), label=label)


def cells_by_hand(points, settings, start):
    """Zone, ring, sector, row and column of each point, the angle by numpy's arctangent; -1 outside."""
    x, y = points[:, 0].astype(float), points[:, 1].astype(float)
    r, turn = np.hypot(x, y), (np.arctan2(y, x) - start) / (2.0 * np.pi) % 1.0
    out = np.full((len(points), 5), -1)
    edges = [*settings.zone_starts_m, settings.end_m]
    for zone, (near, far) in enumerate(pairwise(edges)):
        inside = (r >= near) & (r < far)
        outward = (r[inside] - near) / (far - near) * settings.rings[zone]
        around = turn[inside] * settings.sectors[zone]
        parts = [np.floor(outward), np.floor(around), outward % 1 * settings.pixels, around % 1 * settings.pixels]
        out[inside] = np.column_stack([np.full(inside.sum(), zone), *np.floor(parts)])
    return out


@pytest.mark.parametrize("settings", [FIXED, replace(FIXED, pixels=9, least_points=50, anchored=True)])
def test_every_sector_is_that_of_a_loop_by_hand(settings):
    scan = made_scan(3, 25_000)
    stack = polar_sectors(scan, settings)
    cells = cells_by_hand(scan.points, settings, stack.azimuth_start_rad)
    assert len(stack.zone) > 50
    listed = set()
    for place in sorted({tuple(c) for c in cells[:, :3].tolist()} - {(-1, -1, -1)}):
        mine = (cells[:, :3] == place).all(axis=1)
        if mine.sum() <= settings.least_points:
            continue
        row = len(listed)
        listed.add(place)
        assert (stack.zone[row], stack.ring[row], stack.sector[row], stack.count[row]) == (*place, mine.sum())
        assert (stack.point_sector[mine] == row).all()
        own = mine & stack.point_ground
        if own.sum() < 10:
            assert stack.ground_count[row] == stack.coverage[row] == 0
            assert np.isnan(stack.variance[row])
            assert not stack.traversable[row]
            continue
        assert stack.ground_count[row] == own.sum()
        points = scan.points[own].astype(float)
        values, axes = np.linalg.eigh(np.cov(points.T))
        axis = axes[:, 0] * (1 if axes[2, 0] >= 0 else -1)
        assert values[0] >= 0
        np.testing.assert_allclose(stack.normal[row], axis, atol=2e-5)
        assert stack.variance[row] == pytest.approx(points[:, 2].var(), rel=1e-5)
        pixels = cells[own, 3] * settings.pixels + cells[own, 4]
        assert stack.coverage[row] == pytest.approx(len(set(pixels.tolist())) / settings.pixels**2, rel=1e-6)
    assert len(listed) == len(stack.zone)
    assert (stack.point_sector >= 0).sum() == stack.count.sum()


def test_heights_stand_over_the_plane_and_holes_take_their_neighbours_mean():
    settings = replace(FIXED, zone_starts_m=(10.0,), end_m=20.0, sectors=(8,), rings=(1,))
    rows, columns = np.indices((15, 15))
    r = 10.0 + 10.0 * (rows + 0.5) / 15
    turn = (columns + 0.5) / 15 * 2 * np.pi / 8
    x, y = r * np.cos(turn), r * np.sin(turn)
    bump = np.where((rows == 7) & (columns == 4), 0.118, 0.0) + np.where((rows == 3) & (columns == 10), 0.112, 0.0)
    z = 0.2 * x - 0.1 * y - 2.0 + bump
    kept = ~((rows == 3) & (columns == 9))
    stack = polar_sectors(Scan(np.stack([x, y, z], axis=-1)[kept].astype(np.float32)), settings)
    bump[3, 9] = 0.112 / 8
    np.testing.assert_allclose(stack.heights[0], bump, atol=1e-5)
    assert stack.coverage[0] == pytest.approx(224 / 225)
    # All but two points lie on the plane; these stand 11.8 and 11.2 cm over it, seen along its normal.
    assert stack.residual[0] == pytest.approx(0.23 / math.sqrt(1 + 0.2**2 + 0.1**2) / 224, rel=1e-4)
    assert stack.traversable.all()


@pytest.mark.parametrize("tilt", [0, 36, 40, 90])
def test_ground_is_as_steep_as_its_points_and_not_steeper_than_38_degrees(tilt):
    rng = np.random.default_rng(tilt)
    across, along = rng.uniform(-1, 1, (2, 400))
    slope = math.radians(tilt)
    points = np.column_stack([15.0 + across * math.cos(slope), 2.0 + along, across * math.sin(slope) - 1.0])
    stack = polar_sectors(
        Scan(points.astype(np.float32)), replace(FIXED, zone_starts_m=(13.0,), end_m=18.0, sectors=(24,), rings=(1,))
    )
    assert stack.traversable.tolist() == [tilt < 38]
    assert float(stack.normal[0, 2]) == pytest.approx(math.cos(slope) if tilt < 38 else 0.0, abs=1e-5)


def test_a_ceiling_is_no_ground():
    rng = np.random.default_rng(2)
    flat = np.column_stack([rng.uniform(10, 14, 500), rng.uniform(0.5, 3, 500), np.full(500, -1.0)]).astype(np.float32)
    assert polar_sectors(Scan(flat)).traversable.all()
    above = flat + np.float32([0, 0, 5])
    assert not polar_sectors(Scan(above)).traversable.any()
    assert polar_sectors(Scan(above), PolarSettings(overhead_m=math.inf)).traversable.all()


def test_the_anchor_turns_with_the_scan_and_sectors_keep_their_points():
    scan = made_scan(5)
    stack = polar_sectors(scan)
    for angle in (0.03, 2.5):
        c, s = math.cos(angle), math.sin(angle)
        turned = (scan.points.astype(float) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])).astype(np.float32)
        start = anchor_of(turned, PolarSettings())
        assert (start - stack.azimuth_start_rad - angle + np.pi) % (2 * np.pi) - np.pi == pytest.approx(0, abs=1e-6)
        other = polar_sectors(Scan(turned))
        assert (other.point_sector == stack.point_sector).mean() > 0.995
        before, after = (point_classes(Scan(p), classify_filter(t)) for p, t in ((scan.points, stack), (turned, other)))
        assert set(before.tolist()) == {0, 255}
        assert (before == after).mean() >= 0.97


def test_labels_are_the_most_frequent_the_smallest_of_equals():
    scan = made_scan(7, labels=True)
    stack = polar_sectors(scan)
    for row in range(len(stack.zone)):
        ids, counts = np.unique(scan.label[stack.point_sector == row], return_counts=True)
        assert stack.label[row] == ids[counts.argmax()]
    assert (polar_sectors(made_scan(7)).label == -1).all()


@pytest.mark.parametrize(
    "points", [np.empty((0, 3)), np.zeros((1, 3)), np.full((40, 3), np.nan), np.full((200, 3), 0.5)]
)
def test_a_scan_without_a_full_sector_gives_an_empty_result(points):
    scan = Scan(points.astype(np.float32))
    classed = classify_filter(polar_sectors(scan))
    assert len(classed.class_id) == len(classed.stripes) == 0
    assert (point_classes(scan, classed) == NOT_TRAVERSABLE).all()
    assert len(point_classes(scan, classed)) == len(points)


def test_labels_beyond_semantic_ids_are_refused():
    scan = made_scan(1, labels=True)
    scan.label[3] = 40_000
    with pytest.raises(BadInputError, match="40000"):
        polar_sectors(scan)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"zone_starts_m": (1.0, 4.0, 2.0, 28.0, 60.0)}, "grow outwards"),
        ({"end_m": math.inf}, "grow outwards"),
        ({"sectors": (24, 32)}, r"for 5 \(ending at 100 m\), 2 and 5"),
        ({"rings": (2, 4, 4, 4, 0)}, "`rings` is 2, 4, 4, 4, 0; it must be a list of whole numbers, at least 1"),
        (
            {"sectors": (16, 2, 32, 48, 32)},
            "`sectors` is 16, 2, 32, 48, 32; it must be a list of whole numbers, at least 3",
        ),
        ({"rings": (10_000, 4, 4, 4, 2)}, "160,480 cells; a polar grid has at most 32,767"),
        ({"sectors": (16, 24, 32, 10**9, 32)}, "a polar grid has at most"),
        ({"pixels": 2}, "pixels is 2; it must be a whole number from 3 to 64"),
        ({"overhead_m": math.nan}, "overhead_m is nan"),
    ],
)
def test_settings_that_make_no_grid_are_refused(wrong, words):
    with pytest.raises(UsageError, match=words):
        PolarSettings(**wrong)


@pytest.mark.parametrize("seed", range(2))
def test_the_residual_is_the_distance_to_the_plane_under_clutter(seed):
    """Oracle: the principal plane, by numpy, of the points near the plane that they were made from."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(10, 13, 300), rng.uniform(0.2, 2.5, 300)
    slope = rng.uniform(-0.3, 0.3, 2)
    z = slope[0] * x + slope[1] * y - 1.4 + 0.01 * rng.standard_normal(300)
    z[:90] += rng.uniform(0.5, 3.0, 90)
    points = np.column_stack([x, y, z]).astype(np.float32)
    stack = polar_sectors(Scan(points), replace(FIXED, zone_starts_m=(9.5,), end_m=14.0, sectors=(24,), rings=(1,)))
    ground = points[90:].astype(float)
    axis = np.linalg.eigh(np.cov(ground.T))[1][:, 0]
    distance = np.abs((points - ground.mean(axis=0)) @ axis)
    assert stack.residual[0] == pytest.approx(distance[stack.point_ground].mean(), rel=0.01)
