"""The files of a frame, read back by readers that bumpymap does not use for them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st
from ply_files import read_vertices

from bumpymap.core import FrameSource, PolarSettings, Scan, point_classes, sector_bounds
from bumpymap.layers import SCAN_CLASS_NAMES, SCAN_COLOURS, name_frames, sample_evenly, write_frame
from bumpymap.layers.scan.cloud import write_cloud
from bumpymap.layers.scan.geometry import outlines
from bumpymap.layers.scan.polygons import write_polygons
from bumpymap.scan import classify_filter, polar_sectors


def test_the_cloud_has_every_point_its_class_and_what_the_sensor_said(scan, classed, tmp_path):
    write_cloud(scan, classed, tmp_path / "a.ply")
    vertex = read_vertices(tmp_path / "a.ply")
    for number, axis in enumerate("xyz"):
        np.testing.assert_array_equal(vertex[axis], scan.points[:, number])
    np.testing.assert_array_equal(vertex["class"], point_classes(scan, classed))
    np.testing.assert_array_equal(vertex["intensity"], scan.intensity)
    np.testing.assert_array_equal(vertex["label"], scan.label)


def test_points_of_a_class_have_its_colour_and_those_of_no_sector_another(scan, classed, tmp_path):
    write_cloud(replace(scan, intensity=None, label=None), classed, tmp_path / "a.ply")
    vertex = read_vertices(tmp_path / "a.ply")
    assert list(vertex.dtype.names) == ["x", "y", "z", "red", "green", "blue", "class"]
    colours = np.stack([vertex[name] for name in ("red", "green", "blue")], axis=1)
    lost = classed.sectors.point_sector < 0
    assert lost.any()
    for class_id in range(3):
        assert (colours[vertex["class"] == class_id] == SCAN_COLOURS[class_id]).all()
    assert (colours[(vertex["class"] == 255) & ~lost] == SCAN_COLOURS[3]).all()
    assert (colours[lost] == SCAN_COLOURS[4]).all()
    assert len(np.unique(SCAN_COLOURS, axis=0)) == len(SCAN_CLASS_NAMES) == 5


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


def test_arcs_keep_within_a_centimetre(scan):
    stack = polar_sectors(scan)
    bounds = sector_bounds(stack)
    for outline, far in zip(outlines(stack), bounds.far, strict=True):
        middles = np.hypot(*((outline[1:] + outline[:-1]) / 2.0).T)
        on_outer = np.isclose(np.hypot(*outline[:-1].T), far) & np.isclose(np.hypot(*outline[1:].T), far)
        assert on_outer.any()
        assert (far - middles[on_outer]).max() < 0.0101


def test_the_polygons_say_what_is_known_of_their_sectors(scan, classed, tmp_path):
    write_polygons("site", classed, tmp_path / "a.json")
    record = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert record["frame"] == "site"
    assert "no longitude and latitude" in record["coordinates_in"]
    stack = classed.sectors
    assert record["azimuth_start_rad"] == stack.azimuth_start_rad
    for number, feature in enumerate(record["features"]):
        said = feature["properties"]
        class_id = int(classed.class_id[number])
        assert (said["zone"], said["ring"], said["sector"]) == (
            stack.zone[number],
            stack.ring[number],
            stack.sector[number],
        )
        assert said["class"] == (None if class_id == 255 else class_id)
        assert said["class_name"] == (SCAN_CLASS_NAMES[class_id] if class_id < 3 else "not traversable")
        assert said["points"] == int((stack.point_sector == number).sum())
        assert said["label"] == stack.label[number]
        for name, value in (
            ("variance", stack.variance),
            ("residual", stack.residual),
            ("coverage", stack.coverage),
            ("stripes", classed.stripes),
        ):
            assert said[name] == pytest.approx(float(value[number]), rel=1e-6)
        np.testing.assert_allclose(said["normal"], stack.normal[number], rtol=1e-6, atol=1e-12)


def test_what_nobody_knows_is_null(classed, tmp_path):
    stack = classed.sectors
    unknown = replace(stack, label=np.full_like(stack.label, -1), residual=np.full_like(stack.residual, np.nan))
    write_polygons("a", replace(classed, sectors=unknown, stripes=None, method="learned"), tmp_path / "a.json")
    record = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    for feature in record["features"]:
        assert [feature["properties"][name] for name in ("label", "residual", "stripes")] == [None] * 3


def test_a_scan_without_points_has_empty_files(nothing, tmp_path):
    write_frame("nothing", *nothing, tmp_path, ("polygons", "cloud", "picture", "table"))
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == [
        "nothing.json",
        "nothing.ply",
        "nothing.png",
    ]
    assert json.loads((tmp_path / "frames" / "nothing.json").read_text(encoding="utf-8"))["features"] == []
    assert len(read_vertices(tmp_path / "frames" / "nothing.ply")) == 0


def test_only_the_products_that_are_wanted_are_written(scan, classed, tmp_path):
    write_frame("a", scan, classed, tmp_path, ("table",))
    assert list(tmp_path.iterdir()) == []
    write_frame("a", scan, classed, tmp_path, ("cloud",))
    assert [path.name for path in (tmp_path / "frames").iterdir()] == ["a.ply"]


@given(st.lists(st.from_regex(r"\A(f[0-3]|[Aa]|00000[0-2]_a)(\.(ply|bin))\Z"), min_size=1, max_size=8))
def test_no_two_frames_have_one_name_on_any_disk(names):
    paths = [Path(f"run{number}") / name for number, name in enumerate(names)]
    frames = name_frames([FrameSource(path) for path in paths])
    assert len({frame.name.casefold() for frame in frames}) == len(paths)
    assert [frame.path for frame in frames] == paths
    stems = [path.stem for path in paths]
    if len({stem.casefold() for stem in stems}) == len(stems):
        assert [frame.name for frame in frames] == stems
    else:
        assert all(frame.name.endswith(f"_{stem}") for frame, stem in zip(frames, stems, strict=True))
        assert sorted(frame.name for frame in frames) == [frame.name for frame in frames]


@pytest.mark.parametrize(("count", "most"), [(3, 5), (5, 5), (1000, 7), (8, 7)])
def test_frames_are_spread_out_from_the_first_to_the_last(count, most):
    frames = name_frames([FrameSource(Path(f"{number}.ply")) for number in range(count)])
    chosen = [int(frame.name) for frame in sample_evenly(frames, most)]
    assert len(chosen) == min(count, most)
    assert (chosen[0], chosen[-1]) == (0, count - 1)
    steps = np.diff(chosen)
    assert steps.min() >= 1
    assert steps.max() - steps.min() <= 1


def test_a_turned_scan_has_turned_polygons(scan):
    """The grid is anchored to the points, so a turn of the scan turns the outlines with it."""
    turn = np.radians(25.0)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = Scan(np.column_stack([scan.points[:, :2] @ matrix.T, scan.points[:, 2]]).astype(np.float32))
    before, after = polar_sectors(scan), polar_sectors(turned)
    place = {key: number for number, key in enumerate(zip(after.zone, after.ring, after.sector, strict=True))}
    first, second = outlines(before), outlines(after)
    common = 0
    for number, key in enumerate(zip(before.zone, before.ring, before.sector, strict=True)):
        if key in place:
            common += 1
            np.testing.assert_allclose(first[number] @ matrix.T, second[place[key]], atol=1e-3)
    assert common > 0.9 * len(first)
