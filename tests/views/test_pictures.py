"""Pictures of scans, and the look at a map in three dimensions: what is where, in which colour."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
from PIL import Image
from small_surveys import run, write_survey
from tile_maps import MadeUpMap

from bumpymap.core import NO_TILE, Barred, PolarSettings, Scan, sector_bounds
from bumpymap.layers import CLOSED_COLOUR, UNKNOWN_COLOUR, RideScale, open_map
from bumpymap.layers.scan_folder import SCAN_COLOURS, SECTOR_STATES, point_styles, sector_states
from bumpymap.scan import classify_filter, polar_sectors
from bumpymap.views import space
from bumpymap.views.light import grey_of, hard_light, levelled
from bumpymap.views.scan_picture import SIDE, paint as paint_image, write_picture
from bumpymap.views.space import painted

pytestmark = [
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),
    pytest.mark.usefixtures("without_views"),
]


@pytest.fixture
def ground():
    return MadeUpMap.around()


def look(ground, side=1):
    """Return the colours of pixels, so many along each side of a tile, and each tile's number along both axes."""
    shape = ground.window.rows * side, ground.window.cols * side
    return painted(ground, np.full(shape, np.nan)), np.ix_(*(np.arange(count) // side for count in shape))


def test_level_ground_has_the_colour_of_its_ride_cost(ground):
    pixels, place = look(ground, 2)
    barred, c_r = ground.barred[place], ground.c_r[place]
    passable = np.isin(barred, (Barred.NO, Barred.OBSTACLE, Barred.STEP))  # the vehicle fits everywhere
    scale = RideScale.of(ground.manifest)
    np.testing.assert_allclose(pixels[passable], scale.colours(c_r[passable]), atol=1.5)
    closed = ~passable & ~np.isin(barred, (Barred.UNKNOWN, NO_TILE))
    for chosen, colour in ((closed, CLOSED_COLOUR), (barred == Barred.UNKNOWN, UNKNOWN_COLOUR)):
        np.testing.assert_array_equal(pixels[chosen], np.broadcast_to(colour[:3], pixels[chosen].shape))
    assert (pixels[barred == NO_TILE] == space.NO_DATA).all()


def test_a_photo_is_levelled_and_leaves_the_colours_of_the_map_where_it_is_mid_grey():
    rng = np.random.default_rng(4)
    photo = rng.uniform(50, 130, (30, 40, 3))
    photo[3, 5] = np.nan
    seen = levelled(photo)
    known = np.isfinite(photo[..., 0])
    assert np.median(grey_of(seen[known])) == pytest.approx(128, abs=2)
    assert (np.isnan(seen[..., 0]) == ~known).all()
    colours = rng.uniform(0, 255, (30, 40, 3))
    np.testing.assert_allclose(hard_light(colours, np.full(colours.shape, 128.0)), colours, atol=1.5)
    np.testing.assert_allclose(hard_light(colours, np.full(colours.shape, np.nan)), colours, atol=1.5)
    darker, lighter = (hard_light(colours, np.full(colours.shape, value)) for value in (40.0, 220.0))
    assert (darker <= colours + 1).all()
    assert (lighter >= colours - 1).all()


def test_closed_pixels_are_grey_and_not_whole_tiles():
    ground, side = MadeUpMap.around(margin=0), 15
    ground.barred[:] = Barred.SPLIT
    ground.c_r[:] = 0.1
    fits = ground.fits = np.random.default_rng(2).random((ground.window.rows * side, ground.window.cols * side)) < 0.7
    pixels, _ = look(ground, side)
    assert (pixels[~fits] == CLOSED_COLOUR[:3]).all()
    colour = RideScale.of(ground.manifest).colours(np.array(0.1))
    np.testing.assert_allclose(pixels[fits], np.tile(colour, (fits.sum(), 1)), atol=1.5)


def test_islands_are_faint_and_nothing_else_is(ground, monkeypatch):
    whole, _ = look(ground)
    zone = np.where(np.arange(ground.c_r.shape[1]) % 2, 1.0, 2.0) * np.ones_like(ground.c_r)
    counts = {"counts": {"zones": {"pieces": 2, "islands": 1}}}
    monkeypatch.setattr(type(ground), "manifest", ground.manifest | counts)
    read = lambda self, window, _: {"zone": self._cut(zone, window, np.nan)}  # noqa: E731
    monkeypatch.setattr(type(ground), "values", read, raising=False)
    pixels, _ = look(ground)
    faint = np.isin(ground.barred, (Barred.NO, Barred.OBSTACLE, Barred.STEP)) & (zone == 2)
    assert faint.any()
    own = RideScale.of(ground.manifest).colours(ground.c_r[faint])
    np.testing.assert_allclose(pixels[faint], 0.4 * own + 0.6 * 128, atol=1.5)
    np.testing.assert_array_equal(pixels[~faint], whole[~faint])


def paint(scan, classed, range_m=40.0):
    return np.asarray(paint_image(scan, classed, range_m))


def pixel(x, y, reach=40.0):
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
    stands = wall & (height >= 0.25) & (height <= 1.38) & ~classed.sectors.point_airborne
    np.testing.assert_array_equal(styles == 3, stands)
    for style, least in ((0, 0.9), (2, 0.9), (3, 0.99), (4, 0.4)):  # obstacles cover others, and all cover what is grey
        chosen = styles == style
        assert chosen.sum() > 100
        assert (picture[rows[chosen], columns[chosen]] == SCAN_COLOURS[style]).all(axis=1).mean() > least


def test_ground_between_points_has_a_shade_of_its_sector_and_red_lines_over_obstacles(scan, classed):
    """Painted without points: around the middle of a sector, off the range rings, is the hue of its class."""
    nothing = dict.fromkeys(("point_sector", "point_ground", "point_airborne", "point_height"), np.zeros(0, np.int32))
    stack, barred = classed.sectors, with_wall(scan, classed)[0].sectors.obstacle
    plain, hatched = (
        paint(
            Scan(np.zeros((0, 3), np.float32)),
            replace(with_sectors(classed, obstacle=own, **nothing), point_class=np.zeros(0, np.uint8)),
        ).astype(float)
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
    for known, is_said in (((scan, classed), False), (nothing, True)):
        panel = paint(*known)[:, SIDE:]
        assert min((panel == colour).all(axis=2).sum() for colour in SCAN_COLOURS) >= 28 * 28
        assert (panel[510:] == 235).all(axis=2).any() == is_said


def test_a_sector_is_free_only_if_it_is_smooth_or_fair_ground_with_nothing_on_it(classed):
    obstacle = np.arange(len(classed.class_id)) % 3 == 0
    states = np.array(SECTOR_STATES)[sector_states(with_sectors(classed, obstacle=obstacle))]
    wanted = np.where(obstacle, "obstacle", np.where(classed.class_id == 2, "rough", "free"))
    assert states.tolist() == np.where(classed.class_id == 255, "not ground", wanted).tolist()


def test_far_points_and_strange_grids_are_no_trouble():
    points = np.array([[1e30, 0, 0], [-1e30, 3, 0], [0, 1e6, 0], [5, 5, 0], [0.1, 0, 9]], np.float32)
    scan = Scan(points)
    for far_m, range_m in ((0.5, 1000.0), (9000.0, 1.0)):
        sectors = polar_sectors(scan, PolarSettings((0.0,), far_m, (3,), (1,)))
        assert paint(scan, classify_filter(sectors), range_m).shape[0] == SIDE


# ---- three dimensions ----


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    """A slope of 0.1, and a way over it."""
    folder = tmp_path_factory.mktemp("space")
    survey = write_survey(folder / "a.las", points=60_000, height=lambda x, _: 0.1 * (x - 500_000) + 50)
    run("map", survey, "--out", folder / "layers", code=0)
    places = "--from", "500005,4000005", "--to", "500015,4000015"
    run("route", folder / "layers", *places, "--out", folder / "way", code=0)
    return folder / "layers", folder / "way"


def test_the_relief_has_its_heights_and_colours_and_ways_lie_over_it(layers):
    drawn = space.space_of(open_map(layers[0]), layers[1])
    used = drawn.vertices[np.unique(drawn.triangles)]
    slope = np.polyfit(used[:, 0], used[:, 2], 1)[0]
    assert slope == pytest.approx(0.1, abs=0.01)
    corners = drawn.vertices[drawn.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()  # seen from above
    assert drawn.colours.shape == drawn.vertices.shape
    assert 0.0 <= drawn.colours.min() < drawn.colours.max() <= 1.0
    (way,) = drawn.ways
    ground = np.polyval(np.polyfit(used[:, 0], used[:, 2], 1), way[:, 0])
    np.testing.assert_allclose(way[:, 2], ground + 0.4, atol=0.1)
    assert np.hypot(*np.diff(way[[0, -1], :2], axis=0)[0]) == pytest.approx(14.1, abs=0.5)


def test_without_a_screen_or_a_driver_it_says_what_to_do(layers, tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "VK_DRIVER_FILES"):
        monkeypatch.delenv(name, raising=False)
    assert "--out view.png" in run("view", layers[0]).output
    assert "view.tif is no picture" in run("view", layers[0], "--out", tmp_path / "view.tif").output
    monkeypatch.setattr(space, "find_library", lambda _: None)
    assert "apt-get install libvulkan1" in run("view", layers[0], "--out", tmp_path / "view.png").output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.open3d
def test_open3d_draws_it_without_a_screen(layers, tmp_path):
    picture = tmp_path / "view.png"
    done = run("view", layers[0], "--route", layers[1], "--out", picture)
    if "Vulkan driver" in done.output:
        pytest.skip(done.output)
    assert done.output == f"Open {picture}.\n"
    pixels = np.asarray(Image.open(picture).convert("RGB")).reshape(-1, 3)
    white, black = ((pixels == shade).all(axis=1).mean() for shade in (255, 0))
    assert 0.1 < white < 0.95  # the ground is there, and what lies beside it
    assert 0 < black < 0.05  # so is the way
