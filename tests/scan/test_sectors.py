"""The polar grid against a loop over sectors, and its ground: made-up ground of known height, drops, real frames."""

import math
from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings as examples, strategies as st

from bumpymap.core import BadInputError, GridSettings, PolarSettings, Scan, UsageError
from bumpymap.lab.label_sets import LABEL_SETS
from bumpymap.readers import read_scan
from bumpymap.scan import ScanClassifier, classify_filter, classify_learned, polar_sectors
from bumpymap.scan.cells import see_cells


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


@pytest.mark.parametrize("settings", [PolarSettings(), PolarSettings(pixels=9, least_points=50)])
def test_every_sector_is_that_of_a_loop_by_hand(settings):
    scan = made_scan(3, 25_000)
    stack = polar_sectors(scan, settings)
    cells = cells_by_hand(scan.points, settings, stack.azimuth_start_rad)
    assert len(stack.zone) > 50
    listed, apart = set(), []
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
        # The ground around pulls at it where few points tell how it leans.
        sides = np.column_stack([points[:, :2] - points[:, :2].mean(axis=0), np.ones(len(points))])
        east, north, _ = np.linalg.lstsq(sides, points[:, 2])[0]
        upright = np.array([-east, -north, 1.0]) / math.sqrt(east**2 + north**2 + 1.0)
        np.testing.assert_allclose(stack.normal[row], upright, atol=0.01)
        apart.append(np.abs(stack.normal[row] - upright).max())
        assert stack.variance[row] == pytest.approx(points[:, 2].var(), rel=1e-5)
        pixels = cells[own, 3] * settings.pixels + cells[own, 4]
        assert stack.coverage[row] == pytest.approx(len(set(pixels.tolist())) / settings.pixels**2, rel=1e-6)
    assert len(listed) == len(stack.zone)
    assert np.median(apart) < 1e-4


def test_heights_stand_over_the_plane_and_holes_take_their_neighbours_mean():
    settings = PolarSettings(zone_starts_m=(10.0,), end_m=20.0, sectors=(8,), rings=(1,))
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
    assert stack.residual[0] == pytest.approx(0.23 / math.sqrt(1 + 0.2**2 + 0.1**2) / 224, rel=2e-4)


@pytest.mark.parametrize("tilt", [0, 36, 40, 90])
def test_ground_is_as_steep_as_its_points_and_not_steeper_than_38_degrees(tilt):
    rng = np.random.default_rng(tilt)
    across, along = rng.uniform(-1, 1, (2, 400))
    slope = math.radians(tilt)
    points = np.column_stack([15.0 + across * math.cos(slope), 2.0 + along, across * math.sin(slope) - 1.0])
    stack = polar_sectors(
        Scan(points.astype(np.float32)), PolarSettings(zone_starts_m=(13.0,), end_m=18.0, sectors=(24,), rings=(1,))
    )
    assert stack.traversable.tolist() == [tilt < 38]
    assert float(stack.normal[0, 2]) == pytest.approx(math.cos(slope) if tilt < 38 else 0.0, abs=1e-5)


def test_sectors_keep_their_points_when_the_robot_turns_and_its_heading_is_known():
    scan = made_scan(5)
    stack = polar_sectors(scan)
    assert stack.azimuth_start_rad == 0.0
    for angle in (0.03, 2.5):
        c, s = math.cos(angle), math.sin(angle)
        turned = (scan.points.astype(float) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])).astype(np.float32)
        other = polar_sectors(Scan(turned, heading_rad=-angle))
        assert (other.point_sector == stack.point_sector).mean() > 0.995
        assert (other.point_ground == stack.point_ground).mean() > 0.995


def test_labels_are_the_most_frequent_the_smallest_of_equals():
    scan = made_scan(7, labels=True)
    stack = polar_sectors(scan)
    for row in range(len(stack.zone)):
        ids, counts = np.unique(scan.label[stack.point_sector == row], return_counts=True)
        assert stack.label[row] == ids[counts.argmax()]
    assert (polar_sectors(made_scan(7)).label == -1).all()
    scan.label[3] = 40_000
    with pytest.raises(BadInputError, match="40000"):
        polar_sectors(scan)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"zone_starts_m": (1.0, 4.0, 2.0, 28.0, 60.0)}, "grow outwards"),
        ({"rings": (2, 4, 4, 4, 0)}, "`rings` is 2, 4, 4, 4, 0; it must be a list of whole numbers, at least 1"),
        ({"rings": (10_000, 4, 4, 4, 2)}, "160,480 cells; a polar grid has at most 32,767"),
        ({"pixels": 2}, "pixels is 2; it must be a whole number from 3 to 64"),
    ],
)
def test_settings_that_make_no_grid_are_refused(wrong, words):
    with pytest.raises(UsageError, match=words):
        PolarSettings(**wrong)


POLAR = PolarSettings()


def rings(seed=0, far=50.0, lines=60, columns=900):
    """Places of the returns of a spinning sensor on open ground, (n, 2) m."""
    rng = np.random.default_rng(seed)
    r = 1.2 * (far / 1.2) ** np.linspace(0, 1, lines)[:, None] * np.ones(columns)
    turn = rng.uniform(0, 2 * np.pi, (lines, columns))
    return np.column_stack([(r * np.cos(turn)).ravel(), (r * np.sin(turn)).ravel()])


def plane(places, slope_deg=0.0, heading=0.0, height=-1.2):
    slope = math.tan(math.radians(slope_deg))
    return height + slope * (places[:, 0] * math.cos(heading) + places[:, 1] * math.sin(heading))


def stack_of(xy, z, **changes):
    points = np.column_stack([xy, z]).astype(np.float32)
    return polar_sectors(Scan(points), PolarSettings(**changes) if changes else None)


def box(rng, x, y, side, low, high, count=400):
    """Points on the sides and the top of a box."""
    place = rng.uniform(-0.5, 0.5, (count, 2)) * side
    edge = rng.integers(0, 3, count)
    place[edge == 0, 0] = np.sign(place[edge == 0, 0]) * side / 2
    place[edge == 1, 1] = np.sign(place[edge == 1, 1]) * side / 2
    z = np.where(edge == 2, high, rng.uniform(low, high, count))
    return np.column_stack([place + np.array([x, y]), z])


@examples(max_examples=12, deadline=None)
@given(
    slope=st.floats(0, 34),
    heading=st.floats(0, 6.28),
    height=st.floats(-2.0, -0.4),
    noise=st.floats(0, 0.02),
    seed=st.integers(0, 9),
)
def test_a_plane_of_any_slope_that_can_be_driven_is_ground_and_heights_stand_on_it(slope, heading, height, noise, seed):
    xy = rings(seed)
    z = plane(xy, slope, heading, height) + noise * np.random.default_rng(seed).standard_normal(len(xy))
    stack = stack_of(xy, z)
    own = stack.point_ground
    assert own.mean() > 0.995
    assert np.abs(stack.point_height[own] - (z - plane(xy, slope, heading, height))[own]).max() < 0.05
    assert stack.origin_height == pytest.approx(-height, abs=0.1)
    assert stack.traversable.mean() > 0.99
    assert not stack.obstacle.any()


def test_boxes_are_obstacles_on_ground_and_crowns_are_overhead():
    rng = np.random.default_rng(1)
    xy = rings(1)
    ground = np.column_stack([xy, plane(xy, 5.0) + 0.01 * rng.standard_normal(len(xy))])
    middles = np.array([(8.0, 3.0), (-6.0, -9.0), (0.0, 15.0)])
    cars = [box(rng, *at, 2.0, low, low + 1.2) for at, low in zip(middles, plane(middles, 5.0), strict=True)]
    crown_xy = np.column_stack([rng.uniform(10, 20, 3000), rng.uniform(-12, -4, 3000)])
    crown = np.column_stack([crown_xy, plane(crown_xy, 5.0) + rng.uniform(3.0, 5.0, 3000)])
    kinds = np.concatenate([np.zeros(len(ground)), np.ones(sum(map(len, cars))), np.full(len(crown), 2)])
    scan = Scan(np.concatenate([ground, *cars, crown]).astype(np.float32))
    stack = polar_sectors(scan)
    truth = scan.points[:, 2] - plane(scan.points[:, :2].astype(float), 5.0)
    assert stack.point_ground[kinds == 0].mean() > 0.985
    assert stack.point_ground[(kinds == 1) & (truth > 0.2)].mean() < 0.01
    assert not stack.point_ground[kinds == 2].any()
    known = np.isfinite(stack.point_height)
    assert known.mean() > 0.99
    assert np.quantile(np.abs(stack.point_height - truth)[known], 0.99) < 0.05
    row = stack.point_sector
    on_cars = (kinds == 1) & (truth > POLAR.belly_m + 0.05) & (row >= 0)
    assert stack.obstacle[row[on_cars]].mean() > 0.99
    held = np.unique(row[on_cars])
    assert np.abs(stack.obstacle_height[held].max() - 1.2) < 0.1
    under = np.unique(row[(kinds == 2) & (row >= 0)])
    without_car = np.setdiff1d(under, held)
    assert stack.traversable[without_car].mean() > 0.9
    assert not stack.obstacle[without_car].any()
    assert np.nanmin(stack.clearance[without_car]) == pytest.approx(3.0, abs=0.1)


def hilly_street(x, y):
    """Height of a road over hills with kerbs and a parked van."""
    hills = 0.4 * np.sin(x / 9.0) * np.sin(y / 11.0 + 1.0) + np.where(np.abs(y) > 4.0, 0.16, 0.0)
    return hills + np.where((np.abs(x - 8.0) < 2.0) & (np.abs(y - 3.0) < 1.0), 1.5, 0.0)


def test_nothing_depends_on_the_order_of_the_points():
    points = seen(hilly_street)
    order = np.random.default_rng(1).permutation(len(points))
    one, two = (polar_sectors(Scan(each)) for each in (points, points[order]))
    for field in fields(one)[1:]:
        before, after = getattr(one, field.name), getattr(two, field.name)
        np.testing.assert_array_equal(before[order] if field.name.startswith("point_") else before, after, field.name)
    cells, shuffled = grid_of(points), grid_of(points[order])
    for field in fields(cells):
        np.testing.assert_array_equal(getattr(cells, field.name), getattr(shuffled, field.name), field.name)


def faced(points, turn, side=1):
    """Points as a robot sees them that is turned, degrees; or in a mirror (side -1)."""
    c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    return (points.astype(float) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) * [1, side, 1]).astype(np.float32)


@pytest.mark.parametrize(("change", "most"), [((37, 1), 0.01), ((0, -1), 0.001)], ids=["turned", "mirrored"])
def test_ground_is_the_same_however_the_robot_faces(change, most):
    points = seen(hilly_street)
    one, two = polar_sectors(Scan(points)), polar_sectors(Scan(faced(points, *change)))
    assert (one.point_ground != two.point_ground).mean() < most
    assert (np.abs(one.point_height - two.point_height) < 0.03).mean() > 0.99


@pytest.mark.parametrize("classify", [classify_filter, classify_learned])
def test_classes_of_points_are_the_same_wherever_sectors_lie(classify):
    points, rng = seen(hilly_street), np.random.default_rng(0)
    before = classify(polar_sectors(Scan(points))).point_class
    noise = (0.005 * rng.standard_normal(points.shape)).astype(np.float32)
    for changed, most in ((faced(points, 37), 0.045), (faced(points, 0, -1), 0.005), (points + noise, 0.01)):
        assert (classify(polar_sectors(Scan(changed))).point_class != before).mean() < most


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("folder", "labels", "least"), [("kitti_labelled", "kitti", 0.91), ("solid_state_labelled", "semantic-kitti", 0.83)]
)
def test_classes_of_points_are_those_of_their_labels_however_the_robot_faces(shared_data, folder, labels, least):
    right, moved = [], []
    for path in sorted((shared_data / "scans" / folder).glob("*.bin")):
        scan = read_scan(path)
        truth = LABEL_SETS[labels].classes_of(scan.label & 0xFFFF)
        found = [classify_learned(polar_sectors(Scan(faced(scan.points, turn)))).point_class for turn in (0, 37)]
        judged = (truth >= 0) & (found[0] < 255)
        right.append((found[0] == truth)[judged].mean())
        moved.append((found[0] != found[1]).mean())
    assert np.mean(right) > least
    assert np.mean(moved) < 0.045


def test_reflections_below_the_ground_are_left_out_and_move_nothing():
    rng = np.random.default_rng(3)
    xy = rings(3)
    z = plane(xy) + 0.01 * rng.standard_normal(len(xy))
    deep = rng.uniform(size=len(xy)) < 0.004
    stack = stack_of(xy, np.where(deep, z - rng.uniform(1.0, 4.0, len(xy)), z))
    assert not stack.point_ground[deep].any()
    assert stack.point_ground[~deep].mean() > 0.99
    assert np.abs(stack.point_height[~deep]).max() < 0.1


def test_a_crown_without_ground_below_it_is_no_ground():
    rng = np.random.default_rng(4)
    xy = rings(4, far=20.0)
    crown_xy = np.column_stack([rng.uniform(24, 30, 4000), rng.uniform(-3, 3, 4000)])
    z = np.concatenate([plane(xy), -1.2 + rng.uniform(2.5, 5.0, 4000)])
    stack = stack_of(np.concatenate([xy, crown_xy]), z)
    there = stack.point_sector[len(xy) :]
    assert not stack.traversable[there[there >= 0]].any()
    assert not stack.point_ground[len(xy) :].any()


@pytest.mark.parametrize("height", [-2.0, -0.6])
def test_a_scan_with_z_down_has_no_ground(height):
    xy = rings(7)
    z = plane(xy, 3.0, 1.0, height)
    assert stack_of(xy, z).traversable.mean() > 0.99
    upside_down = stack_of(xy * [1, -1], -z)
    assert not upside_down.traversable.any()
    assert not upside_down.point_ground.any()
    assert stack_of(xy * [1, -1], -z, overhead_m=math.inf).traversable.any()
    post = box(np.random.default_rng(0), 6.0, 2.0, 1.0, 1.2, 2.4)  # on ground above an origin below the robot
    stack = stack_of(np.concatenate([xy, post[:, :2]]), np.concatenate([plane(xy, 3.0, 1.0, 1.2), post[:, 2]]))
    assert stack.traversable.mean() > 0.9
    assert stack.obstacle.any()


@pytest.mark.parametrize("side", [1.5, 3.0])
def test_cars_beside_the_robot_are_no_ground_and_the_street_is(side):
    """Hoods and roofs 1 and 1.4 m up on both sides, seen from 1.9 m."""

    def street(x, y):
        beside, along = (np.abs(y) > side) & (np.abs(y) < side + 1.8), x % 6.0
        return np.where(beside & (along < 4.4), np.where((along > 0.9) & (along < 3.4), 1.4, 1.0), 0.0)

    points = seen(street, 1.9)
    stack, height = polar_sectors(Scan(points)), points[:, 2] + 1.9
    r = np.hypot(points[:, 0], points[:, 1])
    assert stack.point_ground[(height > 0.4) & (r < 6.0)].mean() < 0.02
    assert stack.point_ground[(height < 0.1) & (r < 20.0)].mean() > 0.9


def test_rain_is_airborne_and_a_post_in_it_stands():
    rng, points = np.random.default_rng(5), seen(lambda x, y: np.where(np.hypot(x - 6.0, y - 1.0) < 0.3, 1.2, 0.0))
    clear = polar_sectors(Scan(points))
    wet, drops = points.copy(), rng.uniform(size=len(points)) < 0.01
    wet[drops] *= rng.uniform(0.2, 0.95, (drops.sum(), 1)).astype(np.float32)
    rainy = polar_sectors(Scan(wet))
    free = clear.traversable & ~clear.obstacle
    assert rainy.point_airborne.sum() > 0.3 * drops.sum()
    assert rainy.obstacle.sum() - clear.obstacle.sum() < 0.04 * free.sum()
    assert rainy.obstacle[rainy.point_sector[(clear.point_height > 0.4) & ~drops]].all()


def test_one_scan_line_of_ground_is_traversable():
    rng, turn = np.random.default_rng(6), np.linspace(0.0, 0.12, 44)
    xy = np.concatenate([rings(6, far=9.0), np.column_stack([10.5 * np.cos(turn), 10.5 * np.sin(turn)])])
    stack = stack_of(xy, plane(xy) + 0.02 * rng.standard_normal(len(xy)))
    assert stack.traversable[stack.point_sector[-44:]].all()


@pytest.mark.realdata
@pytest.mark.parametrize(("name", "least"), [("marv/marv.npz", 35), ("tradr/tradr.npz", 30), ("husky_oru", 60)])
def test_low_robots_find_the_ground_around_them(shared_data, name, least):
    path = shared_data / "scans" / "monoforce" / name
    if path.is_dir():
        scan = read_scan(next(path.glob("*.ply")))
    else:
        cloud = np.load(path)["cloud"].ravel()
        points = np.stack([cloud[axis] for axis in "xyz"], axis=1)
        scan = Scan(np.ascontiguousarray(points[np.hypot(points[:, 0], points[:, 1]) > 0.5]))
    stack = polar_sectors(scan)
    assert stack.traversable.sum() >= least
    # Not stretched to reach the number: what is called ground is thin.
    heights = np.abs(stack.point_height[stack.point_ground])
    assert np.quantile(heights, 0.95) < 0.3


CELLS = GridSettings(0.25, 20.0)


def seen(height_at, sensor_m=1.2, lines=64, seed=0):
    """Points of a sensor of 64 lines over ground of that height; where it is NaN, there is none."""
    rng = np.random.default_rng(seed)
    down = np.radians(np.linspace(-25.0, -1.0, lines))[:, None]
    turn, r = np.linspace(-math.pi, math.pi, 720, endpoint=False), np.arange(0.6, 45.0, 0.02)
    ground = np.broadcast_to(height_at(r * np.cos(turn)[:, None], r * np.sin(turn)[:, None]), (720, len(r)))
    below = (beam <= ground for beam in sensor_m + r * np.tan(down))  # the first place counts
    away = np.array([np.where(each.any(axis=1), r[each.argmax(axis=1)], np.nan) for each in below])
    away += 0.01 * rng.standard_normal(away.shape)
    points = np.stack([away * np.cos(turn), away * np.sin(turn), away * np.tan(down)], axis=-1)
    return points.reshape(-1, 3)[np.isfinite(away).ravel()].astype(np.float32)


def grid_of(points):
    return see_cells(points, classify_filter(polar_sectors(Scan(points))), CELLS).finish(CELLS.resolution_m)


def occupancy_of(points):
    return grid_of(points).occupancy


def centres():
    axis = np.arange(0.125 - 20.0, 20.0, 0.25)
    return np.meshgrid(axis, axis)


def is_free(cells):
    return (cells >= 0) & (cells <= 33)


@pytest.mark.parametrize(("edge", "drop", "origin_m"), [(3.2, 0.4, 1.2), (9.0, 0.6, 1.2), (5.0, 0.6, 0.0)])
def test_a_step_down_bars_the_way(edge, drop, origin_m):
    """Where the origin is the sensor, and where it is on the ground below it."""
    lift = np.float32([0.0, 0.0, 1.2 - origin_m])
    cells = occupancy_of(seen(lambda x, _: np.where(x > edge, -drop, 0.0)) + lift)
    x, y = centres()
    at_edge = (np.abs(x - edge - 0.1) < 0.3) & (np.abs(y) < 5.0)
    assert is_free(cells)[at_edge].mean() < 0.05
    level = occupancy_of(seen(lambda x, _: 0.0 * x) + lift)
    assert (is_free(cells) == is_free(level))[(x < 0.0) | (np.hypot(x, y) < edge - 2.0)].mean() > 0.97


@pytest.mark.parametrize(("at", "width", "depth"), [(4.0, 1.2, 0.6), (7.0, 2.5, 5.0)])
def test_a_ditch_bars_the_way(at, width, depth):
    cells = occupancy_of(seen(lambda x, _: np.where((x > at) & (x < at + width), -depth, 0.0)))
    x, y = centres()
    inside = (x > at) & (x < at + width) & (np.abs(y) < 4.0)
    barred = ~is_free(cells) & inside
    assert barred.any(axis=1)[inside.any(axis=1)].all()  # every straight way across


def test_nothing_is_free_beyond_the_end_of_the_ground():
    cells = occupancy_of(seen(lambda x, _: np.where(x > 6.4, np.nan, 0.0)))
    x, y = centres()
    assert is_free(cells)[x > 6.9].mean() < 0.001
    assert is_free(cells)[(x < 5.5) & (np.hypot(x, y) > 4.0) & (np.hypot(x, y) < 9.0)].mean() > 0.95


def held_by(points):
    """Row and column of the cell of each point."""
    return tuple(np.floor((points[:, 1::-1].T.astype(float) + 20.0) / 0.25).astype(int))


def test_a_trunk_bars_its_own_cells_and_hides_those_behind_it():
    trunk = (6.2, 0.4, 0.15)
    points = seen(lambda x, y: np.where(np.hypot(x - trunk[0], y - trunk[1]) < trunk[2], 2.0, 0.0))
    grid, (x, y) = grid_of(points), centres()
    on_trunk = (np.hypot(points[:, 0] - trunk[0], points[:, 1] - trunk[1]) < 0.3) & (points[:, 2] > -0.9)
    held = np.zeros(grid.occupancy.shape, bool)
    held[held_by(points[on_trunk])] = True
    np.testing.assert_array_equal(grid.occupancy == 100, held)  # nothing else of the sector
    assert grid.obstacle_height[held] == pytest.approx(1.2, abs=0.2)  # the highest beam
    near = np.abs(np.arctan2(y, x) - np.arctan2(trunk[1], trunk[0])) < 0.005
    assert (grid.occupancy[near & (np.hypot(x, y) > 10.0) & (np.hypot(x, y) < 19.0)] == -1).all()
    assert is_free(grid.occupancy)[(np.hypot(x, y) > 3.5) & (np.hypot(x, y) < 5.5)].all()


def test_ground_in_front_of_a_wall_is_as_the_open_ground_around():
    grid = grid_of(seen(lambda x, y: np.where((np.abs(x - 7.2) < 0.2) & (np.abs(y) < 3.0), 1.0, 0.0)))
    x, y = centres()
    for near, occupancy in ((6.0, 0), (6.5, 66), (7.0, 100)):
        there = (x > near) & (x < near + 0.25) & (np.abs(y) < 1.5)
        assert (grid.occupancy[there] == occupancy).mean() > 0.9
        assert occupancy == 100 or (grid.class_id[there] == occupancy // 33).mean() > 0.9


def test_elevations_and_steps_are_those_of_the_ground_in_the_cells():
    points = seen(lambda x, y: np.where(np.abs(y) > 4.0, 0.16, 0.0 * x))
    grid = grid_of(points)
    ground = polar_sectors(Scan(points)).point_ground & (np.abs(points[:, :2]) < 20.0).all(axis=1)
    count, total = np.zeros((2, 160, 160))
    np.add.at(count, held_by(points[ground]), 1)
    np.add.at(total, held_by(points[ground]), points[ground, 2])
    with np.errstate(invalid="ignore"):
        np.testing.assert_allclose(grid.elevation, total / count, atol=1e-5)
    x, y = centres()
    kerb = (np.abs(np.abs(y) - 4.0) < 0.25) & (np.abs(x) < 4.0) & np.isfinite(grid.step)
    assert 0.06 < np.median(grid.step[kerb]) < 0.18  # some cells hold both its top and its foot
    assert np.nanmedian(grid.step[np.abs(y) < 3.5]) < 0.03
    assert (grid.occupancy[count > 0] < 100).all()


def test_ground_seen_beneath_a_vehicle_is_not_free():
    points = seen(lambda x, _: 0.0 * x)
    front = points * (5.0 / np.maximum(points[:, :1], 5.0))  # where a beam passes the side of a vehicle
    stopped = (points[:, 0] > 5.0) & (np.abs(front[:, 1]) < 2.0) & (front[:, 2] > -0.85) & (front[:, 2] < 0.2)
    points[stopped] = front[stopped]
    cells, (x, y) = occupancy_of(points), centres()
    assert ((points[:, 0] > 5.3) & (points[:, 0] < 6.8) & (np.abs(points[:, 1]) < 1.5)).sum() > 100
    assert not is_free(cells)[(x > 5.0) & (x < 6.8) & (np.abs(y) < 1.5)].any()


def around(x, y, yaw, height_at):
    """What a sensor at a place sees of ground of that height, and its pose."""
    c, s = math.cos(yaw), math.sin(yaw)
    points = seen(lambda u, v: height_at(x + c * u - s * v, y + s * u + c * v))
    return points, np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 1.2], [0, 0, 0, 1]])


def test_a_robot_remembers_what_is_out_of_view_and_not_what_has_left():
    classify = ScanClassifier(method="filter", grid={"reach_m": 20.0})

    def truck(x, y):
        return np.where((np.abs(x - 8.0) < 1.0) & (np.abs(y) < 1.0), 1.3, 0.0)

    for step in (0.0, 0.7, 1.4):
        points, pose = around(step, 0.0, 0.3 * step, truck)
        grid = classify(points, pose=pose).grid
    x, y = np.meshgrid(*(np.arange(0.125, 40.0, 0.25) + corner for corner in grid.corner_m))
    side, before = (np.abs(x - 7.1) < 0.2) & (np.abs(y) < 0.8), (np.abs(x - 5.0) < 0.5) & (np.abs(y) < 1.0)
    behind = (x > 10.0) & (x < 14.0) & (np.abs(y) < 0.2)
    assert (grid.occupancy[behind] == -1).all()
    assert np.nanmedian(grid.elevation) == pytest.approx(0.0, abs=0.02)
    back = points @ pose[:3, :3].T[:, 0] < 0.0
    for _ in range(6):  # a sensor that looks back
        assert (grid.occupancy[side] == 100).all()
        assert is_free(grid.occupancy[before]).all()
        grid = classify(points[back], pose=pose).grid
    points, pose = around(1.4, 0.0, 0.0, lambda x, _: 0.0 * x)
    left = [classify(points, pose=pose).grid.occupancy for _ in range(6)]  # the truck has left
    assert (left[0][side] == 100).any()
    assert is_free(left[-1][side | behind]).all()
    came = classify(around(1.4, 0.0, 0.0, truck)[0], pose=pose).grid.occupancy  # it hides what was free
    assert (came[side] == 100).all()
    assert (came[behind] == -1).all()
    for _ in range(101):
        grid = classify(np.float32([[0.0, 0.0, 50.0]]), pose=pose).grid
    assert (grid.occupancy == -1).all()
    pose[:2, 3] = 500.0, -300.0
    assert classify(points, pose=pose).grid.corner_m == (480.0, -320.0)
    for wrong in (np.eye(3), np.diag([1.0, 1.0, 2.0, 1.0]), np.diag([1.0, -1.0, 1.0, 1.0]), "odom"):
        with pytest.raises(UsageError, match="pose must be an array"):
            classify(points, pose=wrong)


def test_sensors_together_know_what_one_of_them_sees():
    """A box hides the ground behind it from one of two sensors on either side."""
    classify = ScanClassifier(method="filter", grid={"reach_m": 20.0})

    def box(x, y):
        return np.where((np.abs(x - 8.0) < 1.0) & (np.abs(y) < 1.0), 1.3, 0.0)

    scans, sensors = zip(around(0.0, 0.0, 0.0, box), around(16.0, 0.0, math.pi, box), strict=True)
    alone, (first, second) = classify(scans[0]).grid, classify.together(scans, sensors=sensors)
    x, y = centres()
    behind, near = (x > 10.0) & (x < 13.0) & (np.abs(y) < 0.2), (x > 7.2) & (x < 8.8) & (np.abs(y) < 0.8)
    assert (alone.occupancy[behind] == -1).all()
    assert is_free(first.grid.occupancy[behind]).all()
    assert not is_free(first.grid.occupancy[near]).any()
    assert (first.grid.occupancy[alone.occupancy == 100] == 100).all()
    assert (second.grid is first.grid, first.grid.corner_m) == (True, (-20.0, -20.0))
    assert np.nanmedian(first.grid.elevation) == pytest.approx(0.0, abs=0.02)  # in the frame of the robot
    away = np.array([[0, -1, 0, 300.0], [1, 0, 0, 0], [0, 0, 1, 2.0], [0, 0, 0, 1]])
    grid = classify.together(scans, sensors=sensors, pose=away)[0].grid
    assert grid.corner_m == (280.0, -20.0)
    turned = np.rot90(grid.occupancy)
    assert (is_free(turned) == is_free(first.grid.occupancy))[np.hypot(x, y) < 18.0].mean() > 0.97
    with pytest.raises(UsageError, match="2 scans and 1 sensors"):
        classify.together(scans, sensors=sensors[:1])


@pytest.mark.realdata
@pytest.mark.parametrize(("frame", "labels"), [("kitti01_2", "kitti"), ("nerox_09", "semantic-kitti")])
def test_cells_of_ground_are_free_and_cells_of_obstacles_barred(shared_data, frame, labels):
    """Cells that hold nothing but labelled ground, and those that hold points of labelled obstacles."""
    scan, kinds = read_scan(next((shared_data / "scans").glob(f"*/{frame}.bin"))), LABEL_SETS[labels]
    stack = polar_sectors(scan)
    grid = see_cells(scan.points, classify_filter(stack), CELLS).finish(CELLS.resolution_m)
    label = scan.label & 0xFFFF if labels == "semantic-kitti" else scan.label
    inside = (np.abs(scan.points[:, :2]) < 20.0).all(axis=1) & (stack.point_sector >= 0)
    ground, solid = np.isin(label, [*kinds.ground]), np.isin(label, [*kinds.obstacle])
    height = stack.point_height
    solid &= (height > 0.3) & (height < 1.3) & ~stack.point_ground

    def count(chosen):
        found = np.zeros(grid.occupancy.shape, int)
        np.add.at(found, held_by(scan.points[inside & chosen]), 1)
        return found

    bare = (count(ground) > 0) & (count(~ground) == 0)
    assert ((grid.occupancy[bare] == 100) | (grid.occupancy[bare] == -1)).mean() < 0.05
    assert (grid.occupancy[count(solid) > 1] == 100).mean() > 0.98


@pytest.mark.parametrize(
    "height_at",
    [
        lambda x, _: np.where(x > 6.0, -0.2 * (x - 6.0), 0.0),
        lambda x, y: 0.4 * np.sin(x / 9.0) * np.sin(y / 11.0 + 1.0),
        lambda x, y: np.where(np.abs(y) > 4.0, 0.16, 0.0 * x),
        lambda x, _: np.clip(0.25 * (x - 4.0), 0.0, 0.9),
    ],
    ids=["ramp", "hills", "kerbs", "terrace"],
)
def test_slopes_hills_kerbs_and_terraces_are_no_drops(height_at):
    stack = polar_sectors(Scan(seen(height_at)))
    assert stack.traversable.mean() > 0.9
    assert stack.obstacle.mean() < 0.03


def test_heights_of_obstacles_are_not_known_at_a_drop():
    stack = polar_sectors(Scan(seen(lambda x, _: np.where(x > 5.0, -1.0, 0.0))))
    assert stack.obstacle.any()
    assert np.isnan(stack.obstacle_height).all()


def test_reflections_in_wet_ground_are_no_drops():
    points = seen(lambda x, _: 0.0 * x)
    rng = np.random.default_rng(3)
    far = (np.hypot(points[:, 0], points[:, 1]) > 4.0) & (rng.uniform(size=len(points)) < 0.02)
    points[far] *= rng.uniform(1.3, 2.0, (far.sum(), 1)).astype(np.float32)
    stack = polar_sectors(Scan(points))
    assert (stack.obstacle & np.isnan(stack.obstacle_height)).mean() < 0.03
