"""The picture of a scan: what is where, in which colour."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio

from bumpymap.core import PolarSettings, Scan, sector_bounds
from bumpymap.layers.scan_folder import SCAN_COLOURS, SECTOR_STATES, point_styles, sector_states
from bumpymap.scan import classify_filter, polar_sectors
from bumpymap.views.pictures.scan_picture import SIDE, paint as paint_image, write_picture

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

RANGE = 40.0


def paint(scan, classed, range_m=RANGE):
    return np.asarray(paint_image(scan, classed, range_m))


def pixel(x, y, reach=RANGE):
    """Forward is up, left is left."""
    return int(np.floor((reach - x) * SIDE / (2 * reach))), int(np.floor((reach - y) * SIDE / (2 * reach)))


def with_sectors(classed, **changes):
    return replace(classed, sectors=replace(classed.sectors, **changes))


def with_wall(scan, classed):
    """The wall ahead stands on ground: points of a known height, an obstacle in each of its sectors."""
    stack = classed.sectors
    wall = np.abs(scan.points[:, 0] - 14.0) < 0.1
    height = np.where(wall, scan.points[:, 2] + 1.5, np.nan).astype(np.float32)
    inside = stack.point_sector[wall]
    obstacle = np.isin(np.arange(len(stack.zone)), inside[inside >= 0])
    ground = stack.point_ground & ~wall
    return with_sectors(classed, point_height=height, obstacle=obstacle, point_ground=ground), wall


def test_the_file_holds_what_was_painted_and_the_same_bytes_every_time(scan, classed, tmp_path):
    for name in ("a.png", "b.png"):
        write_picture(scan, classed, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with rasterio.open(tmp_path / "a.png") as file:
        assert file.driver == "PNG"
        np.testing.assert_array_equal(file.read().transpose(1, 2, 0), paint(scan, classed))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png"]


def test_points_stand_where_they_are_ground_in_the_colour_of_its_class_obstacles_in_red(scan, classed):
    classed, wall = with_wall(scan, classed)
    picture, styles = paint(scan, classed), point_styles(classed)
    rows, columns = np.array([pixel(x, y) for x, y in scan.points[:, :2].astype(float)]).T
    height = classed.sectors.point_height
    stands = wall & (height >= 0.25) & (height <= 1.38)
    np.testing.assert_array_equal(styles == 3, stands)
    for style, least in ((0, 0.9), (2, 0.9), (3, 0.99), (4, 0.4)):  # obstacles cover others, and all cover what is grey
        chosen = styles == style
        assert chosen.sum() > 100
        assert (picture[rows[chosen], columns[chosen]] == SCAN_COLOURS[style]).all(axis=1).mean() > least


def test_what_is_ground_decides_the_style_of_a_point_not_its_sector(scan, classed):
    """Low things and crowns in a sector with ground are not ground, and not obstacles."""
    stack = classed.sectors
    inside = np.flatnonzero((stack.point_sector >= 0) & stack.point_ground)[:4]
    height, ground = stack.point_height.copy(), stack.point_ground.copy()
    height[inside] = [0.02, 0.1, 0.8, 3.0]
    ground[inside] = [True, False, False, False]
    styles = point_styles(with_sectors(classed, point_height=height, point_ground=ground))
    assert styles[inside].tolist() == [classed.class_id[stack.point_sector[inside[0]]], 4, 3, 4]


def test_ground_between_points_has_a_shade_of_its_sector_and_red_lines_over_obstacles(scan, classed):
    """Painted without points: around the middle of a sector, off the range rings, is the hue of its class."""
    nothing = dict.fromkeys(("point_sector", "point_ground", "point_height"), np.zeros(0, np.int32))
    stack, barred = classed.sectors, with_wall(scan, classed)[0].sectors.obstacle
    plain, hatched = (
        paint(Scan(np.zeros((0, 3), np.float32)), with_sectors(classed, obstacle=own, **nothing)).astype(float)
        for own in (np.zeros_like(barred), barred)
    )
    paper = plain[5, SIDE + 5]
    bounds = sector_bounds(stack)
    off = 0
    for number, class_id in enumerate(classed.class_id):
        distance = 0.4 * bounds.near[number] + 0.6 * bounds.far[number]
        azimuth = (bounds.left + bounds.right)[number] / 2
        place = pixel(distance * np.cos(azimuth), distance * np.sin(azimuth))
        around = tuple(slice(axis - 7, axis + 8) for axis in place)
        if class_id < 3:
            wanted = paper + 0.42 * (SCAN_COLOURS[class_id] - paper)
            off += np.abs(plain[place] - wanted).max() > 1.5
        changed = (plain[around] != hatched[around]).any()
        assert changed or not barred[number]
    assert off <= 0.02 * len(classed.class_id)  # under the words of the range rings


def test_the_legend_has_a_swatch_of_every_style_and_says_when_there_is_nothing(scan, classed, nothing):
    full, empty = (paint(*known)[:, SIDE:] for known in ((scan, classed), nothing))
    for panel in (full, empty):
        for colour in SCAN_COLOURS:
            assert (panel == colour).all(axis=2).sum() >= 28 * 28
    ink = [(panel[510:] == 235).all(axis=2).sum() for panel in (full, empty)]
    assert ink[0] == 0
    assert ink[1] > 0


def test_a_sector_is_free_only_if_it_is_smooth_or_fair_ground_with_nothing_on_it(classed):
    stack = classed.sectors
    obstacle = np.arange(len(stack.zone)) % 3 == 0
    states = sector_states(with_sectors(classed, obstacle=obstacle))
    for number, state in enumerate(states):
        class_id = classed.class_id[number]
        wanted = "not ground" if class_id == 255 else "obstacle" if obstacle[number] else "free"
        assert SECTOR_STATES[state] == ("rough" if wanted == "free" and class_id == 2 else wanted)


def test_far_points_and_strange_grids_are_no_trouble():
    points = np.array([[1e30, 0, 0], [-1e30, 3, 0], [0, 1e6, 0], [5, 5, 0], [0.1, 0, 9]], np.float32)
    scan = Scan(points)
    for far_m, range_m in ((0.5, 1000.0), (9000.0, 1.0)):
        sectors = polar_sectors(scan, PolarSettings((0.0,), far_m, (3,), (1,)))
        assert paint(scan, classify_filter(sectors), range_m).shape[0] == SIDE
