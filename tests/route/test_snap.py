import numpy as np
import pytest
import shapely
from route_maps import bare_map
from tile_maps import TileMap

from bumpymap.core import NO_TILE, BadInputError, Barred
from bumpymap.route import CostSettings, parse_point
from bumpymap.route.ground import CostGround
from bumpymap.route.stops import usable_point
from bumpytiles import TileWindow

PLACE = bare_map(TileWindow(160_000, 712_000, 30, 20))


class SnapMap(TileMap):
    """All tiles closed by one code, but for one; points are placed as on a map in a CRS, or without one."""

    def __init__(self, code, *, opened=(12, 14), place=PLACE):
        barred = np.full((20, 30), code, np.uint8)
        barred[opened] = Barred.NO
        super().__init__(np.full(barred.shape, 0.1), barred, georeference=place.georeference, has_crs=place.has_crs)
        self.to_lonlat, self.to_crs = place.to_lonlat, place.to_crs


def usable(site, row, col, snap=0.0, **areas):
    point = tuple(site.at(row, col))
    found = usable_point(CostGround(site, CostSettings(), 10**7, **areas), "the goal", point, snap)
    return tuple(found), point


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (Barred.UNKNOWN, "unknown ground; `unknown=COST`"),
        (Barred.SLOPE, r"not passable \(too steep\)"),
        (Barred.FAILS, r"not passable \(drives fail\)"),
        (Barred.STEP, r"not passable \(step\)"),
        (NO_TILE, "a tile without points"),
    ],
)
def test_the_message_says_what_closes_the_tile_and_where_to_go(code, words):
    site = SnapMap(code)
    with pytest.raises(BadInputError, match=f"the goal lies on .*{words}") as caught:
        usable(site, 12.5, 10.5)
    told = str(caught.value)
    away = float(told.split(" m away", maxsplit=1)[0].rsplit(maxsplit=1)[-1])
    assert 10.5 < away < 12.0  # the middle of the open tile is 12 m away, its side 10.5 m
    assert f"`snap={np.ceil(away):.0f}`" in told
    near = parse_point(told.split(" (longitude", maxsplit=1)[0].rsplit(maxsplit=1)[-1], PLACE)
    assert np.hypot(*np.subtract(near, site.at(12.5, 10.5))) == pytest.approx(away, abs=0.06)
    found, _ = usable(site, 12.5, 10.5, snap=12.0)
    assert found == pytest.approx(near, abs=0.02)
    with pytest.raises(BadInputError, match="m away"):
        usable(site, 12.5, 10.5, snap=10.0)


def test_areas_that_the_user_closed_and_no_open_tile_at_all():
    site = SnapMap(Barred.NO)
    everywhere = np.array([shapely.box(*site.at(20, 0), *site.at(0, 30))])
    with pytest.raises(BadInputError, match=r"`avoid` or `only`.*No tile in the 90 m x 60 m around it"):
        usable(site, 3.5, 3.5, avoid=everywhere)


def test_without_a_crs_the_point_is_given_in_coordinates_of_the_survey():
    site = SnapMap(Barred.STEP, place=bare_map(PLACE.window, crs=None))
    with pytest.raises(BadInputError, match=r"at crs:48004\d\.\d\d,21360\d\d\.\d\d") as caught:
        usable(site, 12.5, 10.5)
    assert "longitude" not in str(caught.value)
