"""Files of scans, read back by readers that bumpymap does not use for them; what a folder of a run may hold."""

from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings, strategies as st
from ply_files import read_vertices
from pyproj import CRS
from small_surveys import files_in

from bumpymap.core import Frame, sector_bounds
from bumpymap.core.errors import OutputError
from bumpymap.layers import check_scan_folder, move_products, name_frames, open_accumulated
from bumpymap.layers.scan_files import COLUMNS, open_table, sector_rows, write_cloud
from bumpymap.layers.scan_folder import SCAN_COLOURS


def test_points_say_whether_they_are_ground_how_high_and_in_the_colour_of_that(scan, classed, tmp_path):
    rng = np.random.default_rng(7)
    height = np.where(rng.uniform(size=len(scan.points)) < 0.2, np.nan, rng.uniform(0, 3, len(scan.points)))
    stack = replace(classed.sectors, point_height=height.astype(np.float32), point_ground=height < 0.1)
    write_cloud(replace(scan, label=None), replace(classed, sectors=stack), tmp_path / "b.ply")
    assert "label" not in read_vertices(tmp_path / "b.ply").dtype.names
    write_cloud(scan, replace(classed, sectors=stack), tmp_path / "a.ply")
    vertex = read_vertices(tmp_path / "a.ply")
    np.testing.assert_array_equal(np.stack([vertex[axis] for axis in "xyz"], axis=1), scan.points)
    own = {"class": classed.point_class, "intensity": scan.intensity, "label": scan.label}
    for name, values in (own | {"height": stack.point_height, "ground": stack.point_ground}).items():
        np.testing.assert_array_equal(vertex[name], values)
    colours = np.stack([vertex[name] for name in ("red", "green", "blue")], axis=1)
    class_id = vertex["class"].astype(int)
    is_ground, stands = height < 0.1, (height >= 0.25) & (height <= 1.38) & ~stack.point_airborne
    for style, chosen in enumerate(
        [*(is_ground & (class_id == own) for own in range(3)), stands, ~stands & (~is_ground | (class_id == 255))]
    ):
        assert chosen.any()
        assert (colours[chosen] == SCAN_COLOURS[style]).all()
    assert len(np.unique(SCAN_COLOURS, axis=0)) == 5


def rows_of(path, *frames):
    with open_table(path) as add_rows:
        for name, classed in frames:
            add_rows(sector_rows(name, classed))
    return pq.read_table(path)


@settings(max_examples=40)
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


def test_rows_are_the_sectors_of_all_frames_in_order(classed, nothing, tmp_path):
    found = rows_of(tmp_path / "a.parquet", ("one", classed), ("empty", nothing[1]), ("two", classed))
    stack, count = classed.sectors, len(classed.class_id)
    assert found.column_names == [name for name, *_ in COLUMNS]
    assert found["frame"].to_pylist() == ["one"] * count + ["two"] * count
    same = ("zone", "ring", "sector", "traversable", "obstacle", "obstacle_height", "clearance")
    expected = {name: getattr(stack, name) for name in (*same, "variance", "residual", "coverage", "label")}
    expected |= {f"normal_{axis}": stack.normal[:, number] for number, axis in enumerate("xyz")}
    bounds = sector_bounds(stack)
    expected |= {name: getattr(bounds, name).astype(np.float32) for name in ("near", "far", "right", "left")}
    expected |= {"points": stack.count, "ground_points": stack.ground_count, "stripes": classed.stripes}
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name].to_numpy(), np.concatenate([values, values]), err_msg=name)
    class_id = [None if value == 255 else value for value in classed.class_id.tolist()]
    assert found["class"].to_pylist() == class_id + class_id
    assert [value is None for value in class_id] == (~stack.traversable).tolist()


def fill(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")


@pytest.mark.parametrize(
    ("files", "overwrite", "words"),
    [
        *([[name], False, r"already holds .*`overwrite=True`"] for name in ("sectors.parquet", "map/run.json")),
        (["scan.json", "frames/a.png"], False, r"already holds .*`overwrite=True`"),
        (["frames/a.png"], True, "frames was not written by a complete scan run"),
        (["scan.json", "frames/notes.txt"], True, r"notes\.txt was not written by a complete scan run"),
        *([[name], True, "not what a scan run writes"] for name in ("frames", "scan.json/a")),
    ],
)
def test_a_folder_that_holds_something_else_or_an_earlier_run_is_refused(tmp_path, files, overwrite, words):
    fill(tmp_path, *files)
    with pytest.raises(OutputError, match=words):
        check_scan_folder(tmp_path, overwrite=overwrite)
    assert sorted(files_in(tmp_path)) == sorted(files)
    if not overwrite:
        fill(tmp_path, "scan.json")
        check_scan_folder(tmp_path, overwrite=True)


@pytest.mark.parametrize("ended", [True, False])
def test_the_scans_that_are_read_are_not_replaced(tmp_path, ended):
    fill(tmp_path, "drive/frames/0.ply", *(["drive/scan.json"] if ended else []))
    (tmp_path / "link").symlink_to(tmp_path / "drive")
    with pytest.raises(OutputError, match="is an input of this run"):
        check_scan_folder(tmp_path / "drive", [tmp_path / "link" / "frames" / "0.ply"], overwrite=True)
    check_scan_folder(tmp_path / "out", [tmp_path / "link" / "frames" / "0.ply"], overwrite=True)


def test_older_products_go_and_everything_else_stays(tmp_path):
    fill(tmp_path, "out/frames/a.png", "out/gathered.laz", "out/scan.json", "out/notes.txt", "out/map/my_style.qml")
    fill(tmp_path, "out/map/run.json", "out/map/rasters/class.tif", "out/map/rasters/class.tif.aux.xml")
    fill(tmp_path, "new/sectors.parquet", "new/scan.json")
    assert move_products(tmp_path / "new", tmp_path / "out") == ("sectors.parquet", "scan.json")
    assert sorted(files_in(tmp_path / "out")) == ["map/my_style.qml", "notes.txt", "scan.json", "sectors.parquet"]
    assert not (tmp_path / "out" / "frames").exists()
    (tmp_path / "out" / "map" / "my_style.qml").unlink()
    fill(tmp_path, "out/map/run.json", "newer/scan.json")
    move_products(tmp_path / "newer", tmp_path / "out")
    assert not (tmp_path / "out" / "map").exists()


@pytest.mark.parametrize("crs", [CRS.from_epsg(32614), None])
def test_points_are_written_where_they_are_with_their_classes(tmp_path, crs):
    rng = np.random.default_rng(1)
    offset = np.array([500_000.0, 4_000_000.0, 321.0])
    world, ground = offset + rng.uniform(-80.0, 80.0, (500, 3)), rng.uniform(size=500) < 0.5
    for name in ("a.laz", "b.laz"):
        with open_accumulated(tmp_path / name, offset, crs) as add_points:
            for part in (slice(200), slice(0), slice(200, None)):
                add_points(world[part], ground[part])
    assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()
    las = laspy.read(tmp_path / "a.laz")
    assert las.header.parse_crs() == crs
    np.testing.assert_allclose(las.xyz, world, atol=0.00051)
    np.testing.assert_array_equal(las.classification, np.where(ground, 2, 1))
    np.testing.assert_allclose(las.header.mins, world.min(axis=0), atol=0.00051)
