"""The files of a frame, read back by readers that bumpymap does not use for them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st
from ply_files import read_vertices

from bumpymap.core import Frame, PolarSettings, point_classes, sector_bounds
from bumpymap.layers import name_frames, write_frame
from bumpymap.layers.scan_folder import SCAN_CLASS_NAMES, SCAN_COLOURS
from bumpymap.layers.scan_frame import write_cloud, write_polygons
from bumpymap.scan import classify_filter, polar_sectors


def test_the_cloud_has_every_point_its_class_and_what_the_sensor_said(scan, classed, tmp_path):
    write_cloud(scan, classed, tmp_path / "a.ply")
    vertex = read_vertices(tmp_path / "a.ply")
    np.testing.assert_array_equal(np.stack([vertex[axis] for axis in "xyz"], axis=1), scan.points)
    for name, values in (("class", point_classes(scan, classed)), ("intensity", scan.intensity), ("label", scan.label)):
        np.testing.assert_array_equal(vertex[name], values)


def test_points_say_whether_they_are_ground_how_high_and_in_the_colour_of_that(scan, classed, tmp_path):
    rng = np.random.default_rng(0)
    height = np.where(rng.uniform(size=len(scan.points)) < 0.2, np.nan, rng.uniform(0, 3, len(scan.points)))
    stack = replace(classed.sectors, point_height=height.astype(np.float32), point_ground=height < 0.1)
    write_cloud(replace(scan, intensity=None, label=None), replace(classed, sectors=stack), tmp_path / "a.ply")
    vertex = read_vertices(tmp_path / "a.ply")
    assert list(vertex.dtype.names) == ["x", "y", "z", "height", "red", "green", "blue", "class", "ground"]
    np.testing.assert_array_equal(vertex["height"], stack.point_height)
    np.testing.assert_array_equal(vertex["ground"], stack.point_ground)
    colours = np.stack([vertex[name] for name in ("red", "green", "blue")], axis=1)
    class_id = vertex["class"].astype(int)
    is_ground, stands = height < 0.1, (height >= 0.25) & (height <= 1.38)
    for style, chosen in enumerate(
        [*(is_ground & (class_id == own) for own in range(3)), stands, ~stands & (~is_ground | (class_id == 255))]
    ):
        assert chosen.any()
        assert (colours[chosen] == SCAN_COLOURS[style]).all()
    assert len(np.unique(SCAN_COLOURS, axis=0)) == 5


@pytest.mark.parametrize("settings", [PolarSettings(), PolarSettings((0.0, 10.0), 30.0, (3, 7), (1, 2))])
def test_every_point_lies_in_the_polygon_of_its_sector_and_polygons_do_not_overlap(scan, settings, tmp_path):
    classed = classify_filter(polar_sectors(scan, settings))
    stack = classed.sectors
    write_polygons("site", classed, tmp_path / "a.json")
    record = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    shapes = [shapely.geometry.shape(feature["geometry"]) for feature in record["features"]]
    assert len(shapes) == len(stack.zone) > 4
    assert all(shape.is_valid and shape.exterior.is_ccw for shape in shapes)
    inside = np.flatnonzero(stack.point_sector >= 0)
    grown = shapely.buffer(np.array(shapes), 0.02)  # arcs are cut by a centimetre at most
    points = shapely.points(scan.points[inside, :2])
    assert shapely.contains(grown[stack.point_sector[inside]], points).all()
    union = shapely.union_all(shapes)
    assert sum(shape.area for shape in shapes) == pytest.approx(union.area, rel=1e-4)
    bounds = sector_bounds(stack)
    exact = (bounds.left - bounds.right) / 2.0 * (bounds.far**2 - bounds.near**2)
    np.testing.assert_allclose([shape.area for shape in shapes], exact, rtol=0.004)


def test_the_polygons_say_what_is_known_of_their_sectors(scan, classed, tmp_path):
    place = np.arange(len(classed.class_id))
    stack = replace(
        classed.sectors,
        obstacle=place % 3 == 0,
        obstacle_height=np.where(place % 3 == 0, 0.3 + place / 100, np.nan).astype(np.float32),
        clearance=np.where(place % 4 == 0, 1.5 + place / 30, np.nan).astype(np.float32),
        ground_count=(classed.sectors.count // 2).astype(np.int32),
    )
    write_polygons("site", replace(classed, sectors=stack), tmp_path / "a.json")
    record = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert record["frame"] == "site"
    assert "no longitude and latitude" in record["coordinates_in"]
    assert record["azimuth_start_rad"] == stack.azimuth_start_rad
    points = np.bincount(stack.point_sector[stack.point_sector >= 0], minlength=len(place))
    for number, feature in enumerate(record["features"]):
        said, class_id = feature["properties"], int(classed.class_id[number])
        expected = {name: getattr(stack, name)[number] for name in ("zone", "ring", "sector", "obstacle", "label")}
        expected |= {"points": points[number], "ground_points": stack.ground_count[number]}
        expected |= {"class": None, "class_name": "not traversable"}
        if class_id != 255:
            expected |= {"class": class_id, "class_name": SCAN_CLASS_NAMES[class_id]}
        assert {name: said[name] for name in expected} == expected
        known = {name: getattr(stack, name) for name in ("variance", "residual", "coverage", "obstacle_height")}
        for name, values in (known | {"stripes": classed.stripes, "clearance": stack.clearance}).items():
            value = np.nan if said[name] is None else said[name]
            assert value == pytest.approx(float(values[number]), rel=1e-6, nan_ok=True)
        np.testing.assert_allclose(said["normal"], stack.normal[number], rtol=1e-6, atol=1e-12)


def test_a_scan_without_points_has_empty_files(nothing, tmp_path):
    write_frame("nothing", *nothing, tmp_path, ("polygons", "cloud", "table"))
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == [
        "nothing.json",
        "nothing.ply",
    ]
    assert json.loads((tmp_path / "frames" / "nothing.json").read_text(encoding="utf-8"))["features"] == []
    assert len(read_vertices(tmp_path / "frames" / "nothing.ply")) == 0


@given(st.lists(st.from_regex(r"\A(f[0-3]|[Aa]|00000[0-2]_a)(\.(ply|bin))\Z"), min_size=1, max_size=8))
def test_no_two_frames_have_one_name_on_any_disk(names):
    paths = [Path(f"run{number}") / name for number, name in enumerate(names)]
    frames = name_frames([Frame(path) for path in paths])
    assert len({frame.name.casefold() for frame in frames}) == len(paths)
    assert [frame.path for frame in frames] == paths
    stems = [path.stem for path in paths]
    if len({stem.casefold() for stem in stems}) == len(stems):
        assert [frame.name for frame in frames] == stems
    else:
        assert all(frame.name.endswith(f"_{stem}") for frame, stem in zip(frames, stems, strict=True))
        assert sorted(frame.name for frame in frames) == [frame.name for frame in frames]
