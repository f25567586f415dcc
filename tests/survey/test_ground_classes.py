"""Classes that are ground: roads, bridge decks, and what the user names."""

import json
import re

import laspy
import numpy as np
import pytest
from small_surveys import run, write_las

import bumpymap

CRS = "EPSG:32614"


def made_road(path, density, road=11, deck=17, ramp=None):
    """A meadow with a road of 9 m from west to east, in the middle on a bridge over a valley 5 m deep.

    Its last 12 m in the east are of the class ``ramp``, if one is given.
    """
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0.0, 60.0, (2, int(density * 60 * 48)))
    on_road, valley = np.abs(y - 24.0) < 4.5, np.abs(x - 30.0) < 9.0
    is_deck = on_road & valley
    z = np.where(valley & ~is_deck, -5.0, 0.0) + rng.normal(0.0, 0.02, len(x))
    classes = np.select([is_deck, on_road & (x > 48.0), on_road], [deck, ramp or road, road], 2)
    beneath = is_deck & (np.abs(y - 24.0) > 3.5) & (rng.random(len(x)) < 0.3)  # seen from the side
    z, classes = np.where(beneath, -5.0, z), np.where(beneath, 2, classes)
    house = (x > 3) & (x < 9) & (y > 3) & (y < 9)
    z, classes = np.where(house, 4.0, z), np.where(house, 6, classes)
    write_las(path, 500_000 + x, 4_000_000 + y, z, crs=CRS, offset=(500_000, 4_000_000, 0), classification=classes)


def tiles_of(folder):
    """Rows of tiles by the place of their middle, m from the corner."""
    table = bumpymap.open(folder).tiles()
    middle = [3.0 * table[axis].to_numpy() + 1.5 - first for axis, first in (("col", 500_000), ("row", 4_000_000))]
    return table, middle


@pytest.mark.parametrize("density", [50, 450])
def test_roads_and_decks_are_ground(tmp_path, density):
    made_road(tmp_path / "road.laz", density)
    assert run("map", tmp_path / "road.laz", "--out", tmp_path / "out", "--quiet").exit_code == 0
    table, (x, y) = tiles_of(tmp_path / "out")
    road = (np.abs(y - 24.0) < 3.0) & (np.abs(x - 30.0) < 27.0)
    ends, deck = road & (np.abs(x - 30.0) > 12.0), (np.abs(y - 24.0) < 2.0) & (np.abs(x - 30.0) < 7.5)
    edge = (np.abs(np.abs(y - 24.0) - 4.5) < 1.5) & (np.abs(x - 30.0) < 6.0)
    assert ends.sum() >= 10
    assert deck.sum() >= 4
    assert (table["class"][ends] == 0).all()
    assert table["passable"][ends].all()
    assert (table["class"][deck] == 0).all()
    assert table["passable"][deck].all()
    assert edge.any()
    assert not table["passable"][edge].any()


def test_other_classes_are_ground_if_the_user_says_so(tmp_path):
    made_road(tmp_path / "road.las", 50, road=40, deck=26)
    assert run("map", tmp_path / "road.las", "--out", tmp_path / "without", "--quiet").exit_code == 0
    given = ("--ground-classes", "2,26,40")
    assert run("map", tmp_path / "road.las", "--out", tmp_path / "out", "--quiet", *given).exit_code == 0
    for folder, share in (("without", 0.0), ("out", 1.0)):
        table, (x, y) = tiles_of(tmp_path / folder)
        road = (np.abs(y - 24.0) < 3.0) & (np.abs(np.abs(x - 30.0) - 19.5) < 7.5)
        assert (table["class"][road] == 0).mean() == share
    told = run("info", tmp_path / "road.las", "--set", "ground_classes=2,26,40").output
    assert "; ground" in told.split("class 26", 1)[1].splitlines()[0]


@pytest.mark.parametrize("density", [50, pytest.param(450, marks=pytest.mark.later)])
def test_classes_of_one_survey_together(tmp_path, density):
    """Ground, a building, a road, a bridge deck and structures of class 26, flush with the road."""
    made_road(tmp_path / "road.laz", density, ramp=26)
    for folder, given in (("without", ()), ("out", ("--ground-classes", "2,11,17,26"))):
        assert run("map", tmp_path / "road.laz", "--out", tmp_path / folder, "--quiet", *given).exit_code == 0
        table, (x, y) = tiles_of(tmp_path / folder)
        road, deck = np.abs(y - 24.0) < 3.0, np.abs(x - 30.0) < 7.5
        assert (table["class"][road & (np.abs(x - 10.5) < 8.5)] == 0).all()
        assert (table["class"][road & (x > 41.0) & (x < 47.0)] == 0).all()
        assert (table["class"][(np.abs(y - 24.0) < 2.0) & deck] == 0).all()
        assert not table["passable"][(np.abs(np.abs(y - 24.0) - 4.5) < 1.5) & (np.abs(x - 30.0) < 6.0)].any()
        on_ramp = table[road & (x > 49.0) & (x < 59.0)]
        assert len(on_ramp) >= 4
        assert (on_ramp["class"] == 0).all() if given else (on_ramp["reason_text"] == "no ground points").all()


def test_info_names_classes_that_lie_on_the_ground_with_their_share_and_height(tmp_path):
    """A track of class 40, named in the file, and trees of class 64, 4 m above the ground beside them."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0.0, 60.0, (2, 60_000))
    classes = np.select([np.abs(y - 31.5) < 4.5, (np.abs(y - 48.0) < 3.0) & (rng.random(len(x)) < 0.5)], [40, 64], 2)
    z = 0.1 * x + np.where(classes == 64, 4.0, 0.0)
    survey = laspy.create(point_format=6, file_version="1.4")
    lookup = b"".join(bytes([code]) + name.ljust(15, b"\0") for code, name in ((40, b"forest track"), (64, b"\x01bad")))
    survey.header.vlrs.append(laspy.VLR("LASF_Spec", 0, "Classification lookup", lookup))
    survey.header.scales, survey.header.offsets = [0.001] * 3, [500_001.0, 4_000_002.0, 0.0]
    survey.x, survey.y, survey.z = 500_001.0 + x, 4_000_002.0 + y, z
    survey.classification = classes.astype(np.uint8)
    survey.write(str(tmp_path / "a.laz"))
    words = ("info", tmp_path / "a.laz", "--crs", CRS)
    facts = json.loads(run(*words, "--json").stdout)["files"][0]
    assert facts["class_names"] == {"40": "forest track"}
    assert facts["class_tiles"] == pytest.approx({"2": 0.85, "40": 0.15, "64": 0.1}, abs=0.005)
    heights = facts["class_heights_m"]
    assert heights.pop("2") is None
    assert heights == pytest.approx({"40": 0.0, "64": 4.0}, abs=0.05)
    told = run(*words).output
    assert re.search(r"class 40 +forest track: 1[45]\.\d% of the points, in 15% of the tiles", told)
    assert "points of class 40 lie on the ground" in told
    assert "--ground-classes 2,11,17,40" in told
    assert "lie on the ground" not in run(*words, "--set", "ground_classes=2,40").output
