import re

import numpy as np
import pytest
from pyproj import CRS, Proj
from route_maps import bare_map

from bumpymap.core import BadInputError, UsageError
from bumpymap.route import parse_point
from bumpytiles import TileWindow

SITE = bare_map()
"""300 m x 240 m at easting 480,000, northing 2,136,000 of UTM zone 14N."""


def test_longitude_and_latitude_and_coordinates_of_the_crs_are_told_apart():
    for easting, northing in ((480_000.0, 2_136_000.0), (480_123.25, 2_136_200.5), (480_299.9, 2_136_239.9)):
        longitude, latitude = SITE.to_lonlat(easting, northing)
        for text in (f"{longitude:.12f},{latitude:.12f}", f"lonlat:{longitude:.12f},{latitude:.12f}"):
            assert parse_point(text, SITE, beyond_m=1e-3) == pytest.approx((easting, northing), abs=1e-4)
        for text in (f"{easting},{northing}", f"crs:{easting},{northing}", f"  CRS : {easting} ; {northing} "):
            assert parse_point(text, SITE) == (easting, northing)


@pytest.mark.parametrize(
    "text", ["480100,2136100", "480100, 2136100", "480100 2136100", "4.801e5,2136.1E3", "+480100.,2136100.0"]
)
def test_ways_to_write_a_point(text):
    assert parse_point(text, SITE) == (480_100.0, 2_136_100.0)


@pytest.mark.parametrize(
    "text", ["", "480100", "a,b", "1,2,3", "utm:1,2", "1,2 m", "nan,nan", "inf,1", "1;;2", "0x10,2", "1_0,2", "-,-"]
)
def test_what_is_no_point_is_refused(text):
    with pytest.raises(UsageError, match=r"is not a point\. Give LON,LAT such as"):
        parse_point(text, SITE)


def test_a_point_outside_the_map_is_refused_with_the_extent_in_both_systems():
    for text in ("11.5,48.1", "480301,2136100", "lonlat:480100,2136100", "crs:-99.19,19.31", "200,95"):
        with pytest.raises(BadInputError) as caught:
            parse_point(text, SITE)
        told = str(caught.value)
        assert f"the point {text} lies outside the map, which spans x 480000.00 to 480300.00, y 2136000.00 to" in told
        assert "2136240.00 in WGS 84 / UTM zone 14N (EPSG:32614), or longitude" in told
        stated = [float(number) for number in re.findall(r"-?\d+\.\d{6}", told)]
        corners = np.array([(x, y) for x in (480_000, 480_300) for y in (2_136_000, 2_136_240)], float)
        longitude, latitude = Proj(32614)(corners[:, 0], corners[:, 1], inverse=True)
        assert stated == pytest.approx([longitude.min(), longitude.max(), latitude.min(), latitude.max()], abs=1e-6)


def test_points_near_the_map_are_taken_if_asked():
    with pytest.raises(BadInputError, match="outside"):
        parse_point("480304,2136243", SITE, beyond_m=4.9)
    assert parse_point("480304,2136243", SITE, beyond_m=5.0) == (480_304.0, 2_136_243.0)
    assert parse_point("480000,2136000", SITE) == (480_000.0, 2_136_000.0)  # the sides in the west and south
    with pytest.raises(BadInputError, match="outside"):
        parse_point("480300,2136000", SITE)


def test_a_point_that_could_be_meant_both_ways_must_be_named():
    """Near the origin of a CRS around 0 degrees, small numbers are coordinates of both."""
    crs = CRS.from_proj4("+proj=tmerc +lat_0=0 +lon_0=0 +datum=WGS84")
    place = bare_map(TileWindow(-100_000, -100_000, 200_000, 200_000), crs=crs)
    with pytest.raises(BadInputError, match=r"both as longitude.*Write lonlat:1\.5,0\.5 or crs:1\.5,0\.5"):
        parse_point("1.5,0.5", place)
    assert parse_point("crs:1.5,0.5", place) == (1.5, 0.5)
    assert parse_point("lonlat:1.5,0.5", place) == pytest.approx(place.from_lonlat(1.5, 0.5))
    assert parse_point("1500,500", place) == (1500.0, 500.0)


def test_a_map_in_feet():
    unit = 1200 / 3937
    place = bare_map(TileWindow(655_000, 187_000, 60, 50), crs=CRS.from_epsg(2229), unit=unit)
    x, y = place.to_crs(655_010 * 3.0, 187_020 * 3.0)
    assert parse_point(f"{x:.6f},{y:.6f}", place) == pytest.approx((655_010 * 3.0, 187_020 * 3.0), abs=1e-5)
    longitude, latitude = place.to_lonlat(655_010 * 3.0, 187_020 * 3.0)
    assert -119.5 < longitude < -117.0
    assert parse_point(f"{longitude:.9f},{latitude:.9f}", place) == pytest.approx(
        (655_010 * 3.0, 187_020 * 3.0), abs=1e-3
    )


def test_a_map_without_a_crs_knows_its_own_coordinates_only():
    place = bare_map(TileWindow(0, 0, 10, 10), crs=None)
    assert parse_point("11.5,20", place) == (11.5, 20.0)
    with pytest.raises(BadInputError, match="has no CRS"):
        parse_point("lonlat:11.5,20", place)
    with pytest.raises(BadInputError, match=r"x 0\.00 to 30\.00, y 0\.00 to 30\.00 in local coordinates") as caught:
        parse_point("40,20", place)
    assert "longitude 0" not in str(caught.value)


def test_swapped_numbers_are_noticed():
    longitude, latitude = SITE.to_lonlat(480_100.0, 2_136_100.0)
    for text, meant in ((f"{latitude:.7f},{longitude:.7f}", "-99"), ("2136100,480100", "480100,2136100")):
        with pytest.raises(BadInputError, match=f"did you mean {meant}"):
            parse_point(text, SITE)
