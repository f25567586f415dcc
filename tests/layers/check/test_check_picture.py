"""The picture of a check: marks lie where the stretches are, in the colour of how far the map is off."""

from dataclasses import replace

import numpy as np
import pytest
from check_records import LIMITS, made_up_check, stretches_at
from PIL import Image
from route_records import MadeUpMap

from bumpymap.layers import write_check
from bumpymap.layers.check import picture as picture_module
from bumpymap.layers.check.offset import LogAxis, MapOffset
from bumpymap.layers.check.picture import Box, draw_scatter, paint_check, view_of
from bumpymap.layers.colours import OFF_COLOURS
from bumpymap.layers.route.drawing import Pen

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.fixture(scope="module")
def ground():
    return MadeUpMap.around()


def test_every_mark_lies_on_its_stretch(ground):
    result = made_up_check(24, noise=0.4)
    image = np.asarray(paint_check(result, ground)).astype(int)
    assert image.shape[1] == 1600
    points = np.column_stack([result.stretches.easting, result.stretches.northing])
    view = view_of(ground, points)
    corner = np.array([picture_module._EDGE, picture_module._TITLE])
    at = np.rint(view.pixels(points) + corner - 0.5).astype(int)
    kinds = MapOffset.of(result.stretches).kind
    wanted = np.array([OFF_COLOURS[int(kind)][:3] for kind in kinds])
    assert len(set(kinds.tolist())) > 3
    assert np.abs(image[at[:, 1], at[:, 0]] - wanted).max() <= 3


@pytest.mark.parametrize("corner", ["south-west", "north-east", "off the map"])
def test_the_view_stays_on_the_map_as_far_as_the_points_allow(ground, corner):
    bounds = ground.grid.window_bounds(ground.window)
    edge = {"south-west": (bounds.west, bounds.south), "north-east": (bounds.east, bounds.north)}
    middle = np.array(edge.get(corner, (bounds.west - 50.0, bounds.south)))
    points = middle + np.array([[-1.0, -1.0], [1.0, 1.0]]) * (0.5 if corner == "off the map" else 0.0)
    view = view_of(ground, points)
    south, east = view.north - view.height * view.metres, view.west + view.width * view.metres
    shown = view.pixels(points)
    assert (shown >= 0).all()
    assert (shown <= [view.width, view.height]).all()
    inside = view.west >= bounds.west and south >= bounds.south and east <= bounds.east and view.north <= bounds.north
    assert inside == (corner != "off the map")


def test_a_mark_of_the_scatter_lies_at_both_values():
    stretches = stretches_at(np.zeros((2, 2)), [0.1, 0.4], np.array([1.0, 3.0]))
    pen, box = Pen(400, 400), Box(50, 20, 330, 330)
    draw_scatter(pen, box, stretches, LIMITS)
    image = np.asarray(pen.finished()).astype(int)
    axis = LogAxis.around(np.concatenate([stretches.c_r, stretches.measured]))
    x = np.rint(box.left + box.width * axis.part(stretches.c_r) - 0.5).astype(int)
    y = np.rint(box.bottom - box.height * axis.part(stretches.measured) - 0.5).astype(int)
    wanted = np.array([OFF_COLOURS[3][:3], OFF_COLOURS[0][:3]])
    assert np.abs(image[y, x] - wanted).max() <= 3


def test_a_logarithmic_axis_holds_its_values_and_round_numbers():
    axis = LogAxis.around(np.array([0.03, 0.9]))
    assert axis.part(np.array([axis.low, np.sqrt(axis.low * axis.high), axis.high])) == pytest.approx([0.0, 0.5, 1.0])
    assert axis.ticks == [0.05, 0.1, 0.2, 0.5, 1.0]
    assert axis.part(np.array([-1.0, 1e9])).tolist() == [0.0, 1.0]
    one = LogAxis.around(np.array([0.2]))
    assert one.high / one.low == pytest.approx(4.0)


@pytest.mark.parametrize("case", ["no map", "one stretch", "nearly nothing known", "nothing measured", "many"])
def test_odd_findings_are_drawn_too(ground, case):
    number = {"one stretch": 1, "many": 3000}.get(case, 8)
    result = made_up_check(number, ground=case != "no map", unknown=range(7) if case == "nearly nothing known" else ())
    if case == "nothing measured":
        result = replace(result, stretches=replace(result.stretches, measured=np.zeros(8)))
    image = paint_check(result, None if case == "no map" else ground)
    assert image.size[0] == 1600
    assert len(image.getcolors(1 << 24)) > 20


def test_a_name_that_is_no_text_is_drawn_in_one_line(ground):
    result = made_up_check(6)
    plain = np.asarray(paint_check(replace(result, ground=replace(result.ground, name="a b\\udce9")), ground))
    odd = np.asarray(paint_check(replace(result, ground=replace(result.ground, name="a\nb\udce9")), ground))
    assert (plain == odd).all()


def test_the_picture_is_written(ground, tmp_path):
    write_check(made_up_check(12), tmp_path, ground=ground)
    with Image.open(tmp_path / "check.png") as image:
        image.load()
        assert image.format == "PNG"
        assert image.size[0] == 1600
