"""The picture of a scan: what is where, in which colour."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio

from bumpymap.core import PolarSettings, Scan, point_classes, sector_bounds
from bumpymap.layers import SCAN_CLASS_NAMES, SCAN_COLOURS
from bumpymap.layers.scan.picture import SIDE, paint as paint_image, scene_radius, write_picture
from bumpymap.scan import classify_filter, polar_sectors

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def paint(scan, classed):
    return np.asarray(paint_image(scan, classed))


def pixel(x, y, reach):
    """Forward is up, left is left."""
    return int(np.floor((reach - x) * SIDE / (2 * reach))), int(np.floor((reach - y) * SIDE / (2 * reach)))


def test_the_file_holds_what_was_painted_and_the_same_bytes_every_time(scan, classed, tmp_path):
    for name in ("a.png", "b.png"):
        write_picture(scan, classed, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with rasterio.open(tmp_path / "a.png") as file:
        assert file.driver == "PNG"
        np.testing.assert_array_equal(file.read().transpose(1, 2, 0), paint(scan, classed))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png"]


def test_points_stand_where_they_are_in_the_colour_of_their_class(scan, classed):
    picture, reach = paint(scan, classed), scene_radius(classed.sectors)
    class_id = point_classes(scan, classed)
    rows, columns = zip(*(pixel(x, y, reach) for x, y in scan.points[:, :2].astype(float)), strict=True)
    rows, columns = np.array(rows), np.array(columns)
    for look, chosen in (
        (0, class_id == 0),
        (2, class_id == 2),
        (3, (class_id == 255) & (classed.sectors.point_sector >= 0)),
    ):
        colours = picture[rows[chosen], columns[chosen]]
        assert (colours == SCAN_COLOURS[look]).all(axis=1).mean() > 0.9  # range rings and words lie over some of them


def test_ground_between_points_has_a_shade_of_its_sector(classed):
    """Painted without points: the middle of a sector, off the range rings, is of the hue of its class."""
    nowhere = Scan(np.zeros((0, 3), np.float32))
    bare = polar_sectors(nowhere)
    stack = replace(classed.sectors, point_sector=bare.point_sector)
    picture, reach = paint(nowhere, replace(classed, sectors=stack)), scene_radius(stack)
    bounds = sector_bounds(stack)
    paper = picture[pixel(0.9 * reach, -0.9 * reach, reach)].astype(float)
    off = 0
    for number, class_id in enumerate(classed.class_id):
        distance = 0.4 * bounds.near[number] + 0.6 * bounds.far[number]
        azimuth = (bounds.left + bounds.right)[number] / 2
        seen = picture[pixel(distance * np.cos(azimuth), distance * np.sin(azimuth), reach)].astype(float)
        wanted = SCAN_COLOURS[min(class_id, 3)].astype(float) - paper
        off += np.abs(seen - paper - 0.42 * wanted).max() > 1.5
    assert off <= 0.02 * len(classed.class_id)  # under the words of the range rings


def test_the_picture_reaches_to_the_farthest_sector(classed, nothing):
    assert scene_radius(classed.sectors) == sector_bounds(classed.sectors).far.max() == pytest.approx(28.0)
    assert scene_radius(nothing[1].sectors) == 12.0
    only = PolarSettings((2.0,), 9.0, (8,), (2,))
    assert scene_radius(polar_sectors(nothing[0], only)) == 9.0


def test_the_legend_has_a_swatch_of_every_look_and_says_when_there_is_nothing(scan, classed, nothing):
    full, empty = (paint(*known)[:, SIDE:] for known in ((scan, classed), nothing))
    for panel in (full, empty):
        for colour in SCAN_COLOURS:
            assert (panel == colour).all(axis=2).sum() >= 28 * 28
    ink = [(panel[480:] == 235).all(axis=2).sum() for panel in (full, empty)]
    assert ink[0] == 0
    assert ink[1] > 0


def test_every_look_has_its_name_and_its_count_beside_its_swatch(scan, classed, nothing):
    """Other counts are other text; the same names are the same."""
    full, empty = (paint(*known)[:, SIDE:] for known in ((scan, classed), nothing))
    names = set()
    for look, colour in enumerate(SCAN_COLOURS):
        rows, columns = np.nonzero((full == colour).all(axis=2))
        top, right = np.bincount(rows).argmax(), columns.max() + 1  # the first of the swatch's longest rows
        name, count = slice(top - 2, top + 17), slice(top + 20, top + 42)
        assert (full[name, right:] == 235).all(axis=2).any(), SCAN_CLASS_NAMES[look]
        np.testing.assert_array_equal(full[name, right:], empty[name, right:])
        assert (full[count, right:] != empty[count, right:]).any(), SCAN_CLASS_NAMES[look]
        names.add(full[name, right:].tobytes())
    assert len(names) == len(SCAN_CLASS_NAMES)


def test_far_points_and_strange_grids_are_no_trouble():
    points = np.array([[1e30, 0, 0], [-1e30, 3, 0], [0, 1e6, 0], [5, 5, 0], [0.1, 0, 9]], np.float32)
    for settings in (
        PolarSettings(),
        PolarSettings((0.0,), 0.5, (3,), (1,)),
        PolarSettings((0.0,), 9000.0, (3,), (1,)),
    ):
        scan = Scan(points)
        assert paint(scan, classify_filter(polar_sectors(scan, settings))).shape[0] == SIDE
