"""Commands as a user gives them: what is printed and written, events for machines, foreign text, what is refused."""

import io
import json
import logging
import re
import shlex
import sys
import unicodedata
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest
from cost_maps import make_field, survey
from made_drives import write_bin
from point_files import read_vertices, write_ply
from pyproj import Transformer
from rich.console import Console
from route_maps import ROWS, RUN, SOUTH, WEST, copy_folder, list_anew, lonlat, place, site, write_folder
from small_surveys import run, write_las, write_survey

from bumpymap.cli import _output, exit_code_of
from bumpymap.cli._output import print_error, print_json, print_line, print_table
from bumpymap.core import BadInputError, escape_controls

QUARRY = Path(__file__).resolve().parents[2] / "sample_data" / "quarry.laz"


def scanned(count=12_000, seed=0):
    """Points around a sensor: rough ground on one side, smooth ground on the other."""
    rng = np.random.default_rng(seed)
    radius, azimuth = np.sqrt(rng.uniform(1.0, 144.0, count)), rng.uniform(-np.pi, np.pi, count)
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    return np.column_stack([x, y, -1.0 + np.where(y < 0, 0.2, 0.002) * rng.standard_normal(count)])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Layers of a field, of a site with a wall, and of two surveys of one place; scans; files of other kinds."""
    root = tmp_path_factory.mktemp("made")
    sites = {"field": make_field(6, 6, holes=0.0), "layers": site(), "may": survey(1)}
    wall = np.where(site().patches.col == WEST + 15, 60.0, 2.0)  # without a gap
    sites["closed"] = replace(site(), patches=replace(site().patches, slope=wall))
    for name, layers in (sites | {"june": survey(2, rut=0.1, c_r=3.0)}).items():
        write_folder(root / name, layers, views=name == "field")
    write_ply(root / "frame.ply", np.rec.fromarrays(scanned().astype("<f4").T, names="x,y,z"))
    # In float32, a UTM northing has steps of half a metre.
    coarse = np.random.default_rng(2).uniform(0.1, 5.9, (3, 900)) + np.array([[500_001], [5_400_000], [0]])
    write_ply(root / "coarse.ply", np.rec.fromarrays(coarse.astype("<f4"), names="x,y,z"))
    write_bin(root / "a.bin", scanned())
    np.random.default_rng(1).uniform(-9.0, 9.0, 60_000).astype("<f4").tofile(root / "doubtful.bin")
    for name, poses in (("one.txt", 1), ("two.txt", 2)):
        (root / name).write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * poses)
    (root / "not.onnx").write_text("no")
    (root / "none").mkdir()
    (root / "a.laz").touch()
    (root / "link.toml").symlink_to(root / "elsewhere.toml")
    return root


@pytest.fixture(autouse=True)
def _here(made, monkeypatch):
    monkeypatch.chdir(made)
    monkeypatch.setenv("COLUMNS", "200")


A, B, C = place(5.5, 5.5), place(5.5, 9.5), place(5.5, 25.5)
ALL = "(car, husky, small_rover, warthog)"
MAP = f"map {shlex.quote(str(QUARRY))} --out OUT"
REFUSED = [
    (2, "mpa site.laz", "Did you mean 'map'?"),
    (2, f"{MAP} --crs EPSG:1", "--crs EPSG:1 is not a coordinate reference system"),
    (2, f"{MAP} --tile-size 4", "Use --tile-size 3, --set pixels=15"),
    (2, f"{MAP} --speed 9", "holds from 0.4 to 2.5 m/s"),
    (2, f"{MAP} --set speeds=1,2", "unknown setting speeds"),
    (2, f"{MAP} --set headings=true", "unknown setting headings"),
    (2, f"{MAP} --speed 1 --set rating=table", "--set rating='table' knows no speed"),
    (2, f"{MAP} --speed 1 --set compat=paper", "--set compat='paper' knows no speed"),
    (2, "map a.laz --out OUT --crs EPSG:32632 --local", "--crs and --local contradict"),
    (2, "map a.laz --out OUT --calibration c.json --vehicle warthog", "--calibration and --vehicle"),
    (2, "map a.laz --out OUT --set compat=paper --set rating=ride", "--set compat and --set rating"),
    (2, "map a.laz --out OUT --set pixels", "give KEY=VALUE"),
    (2, "map a.laz --out OUT --set pixels=a", "pixels is 'a'; it must be a whole number from 3 to 255"),
    (2, "map https://h/a.laz --out o", "rclone copyurl URL FILE"),
    (3, "map coarse.ply --crs EPSG:32614 --out OUT", "steps of 0.5 m"),
    *((3, f"info coarse.ply {how}", "steps of 0.5 m") for how in ("", "--quick", "--json")),
    (2, "map a.laz --out s3://bucket/night", "s3://bucket/night is a URL"),
    (2, "map a.laz --out OUT --vehicle tank", ALL),
    (2, "vehicle check tank", ALL),
    (3, "vehicle new mine --out link.toml", "exists and is not overwritten"),
    (3, "vehicle new mine --out none/x/a.toml", "none/x"),
    (2, "calibrate --out OUT", "bumpymap vehicle new"),
    (2, "check --drive one.txt --out field", "holds the layers of a survey"),
    (2, "check --drive one.txt --out a.json", "Give a folder as --out"),
    (3, "diff may none", "holds no complete run"),
    (2, "export field --out OUT", "Missing option '--to'"),
    (2, "export field --to plan --resolution pixel --out OUT", "--resolution has no effect with --to plan"),
    (2, "export field --to nav2 --radius 20 --out OUT", "--radius has no effect without --around"),
    (3, "export field --to nav2 --around crs:1,2 --out OUT", "lies outside the map"),
    (3, "export field --to plan --out OUT", "pass the folder that it wrote with --route"),
    (2, "export field --to nav2 --out field", "holds the layers of a survey"),
    (2, "report may --out a.json", "ends in .html"),
    (3, "report may --route june", "--route"),
    (3, "report nothing", "there is no folder"),
    (2, f"route layers --to {A}", "give either the --from or a file of --points"),
    (2, f"route layers --from here --to {A}", "'here' is not a point"),
    (2, f"route layers --from {A} --to {B} --unknown 0.5", "unknown is 0.5"),
    (2, f"route layers --from {A} --to {B} --risk 1e300", "risk is 1e+300"),
    (2, f"route layers --from {A}", "more than a start: add --to"),
    (3, f"route layers --from 1,1 --to {A} --out OUT", "lies outside the map"),
    (3, f"route layers --from {place(10.5, 15.5)} --to {A} --out OUT", "not passable (too steep). The nearest point"),
    (3, f"route layers --from {place(20.5, 2.5)} --to {A} --out OUT", "unknown ground; --unknown COST"),
    (
        3,
        f"route closed --from {A} --to {place(5.5, 25.5)}",
        f"no way from the start {A} to the goal {place(5.5, 25.5)}",
    ),
    (3, f"route layers --from {A} --to {B} --avoid none.geojson --out OUT", "none.geojson is missing"),
    (
        2,
        "scan frame.ply --out OUT --set polar.sectors=24,a",
        "value 2 of polar.sectors is 'a'; it must be a whole number",
    ),
    (2, "scan frame.ply --out OUT --crs EPSG:32614", "add --poses"),
    (2, "scan --pictures frame.ply --out OUT", "'frame.ply' is not a whole number"),
    (2, "scan a.bin --out OUT --poses one.txt --calibration c.json --vehicle car", "--calibration"),
    (3, "scan doubtful.bin --out OUT", "Say which they are with --set columns"),
    (3, "scan frame.ply --out OUT --set model=not.onnx", "is not an ONNX model"),
    (2, "evaluate scans drive --out OUT --set total_patches=200", "total_patches"),
    (2, "evaluate scans --out OUT", "FRAME"),
    (2, "train textures --out OUT.onnx --tile-size 3", "--tile-size is no option: write --set tile_size=M"),
    (2, "map site.laz --rating table", "--rating is no option: write --set rating=ride|table"),
    (2, "train scans '' --out OUT.onnx", "the path is empty"),
    (3, "train scans none --out OUT.onnx", "holds no scans"),
    (3, "train textures --out not.onnx", "--overwrite"),
    (2, "train textures --out OUT.pt", ".onnx"),
    (2, "train textures --out OUT.onnx --set network.pixels=5", "at least 9"),
    *(
        (2, line.replace("NAME", name), said)
        for line in ("map NAME --out OUT", "map a.laz --out NAME", "map a.laz --out OUT --set model=NAME", "info NAME")
        for name, said in (("a\0b", "NUL"), ("\u00e9" * 128, "bytes"))
    ),
    *((2, f"{line} a\0b", "NUL") for line in ("scan --out OUT", "calibrate --out")),
]


@pytest.mark.parametrize(("code", "line", "said"), REFUSED)
def test_what_is_refused_is_one_message_in_options_and_leaves_nothing(code, line, said, made, tmp_path):
    if line.startswith("train"):
        pytest.importorskip("torch", reason="torch comes with the extra 'learn'")
    before = {path: path.lstat().st_mtime_ns for path in made.rglob("*")}
    done = run(*shlex.split(line.replace("OUT", str(tmp_path / "out"))), code=code)
    assert said in " ".join(done.output.split())
    assert "`" not in re.sub("`bumpymap [a-z]+`", "", done.output)
    assert "Traceback" not in done.output
    assert list(tmp_path.iterdir()) == []
    assert {path: path.lstat().st_mtime_ns for path in made.rglob("*")} == before


# --- diff, report ---
def test_diff_writes_files_and_replaces_them_if_asked(tmp_path):
    words = "diff", "may", "june", "--out", tmp_path / "out", "--set", "register=false"
    run(*words, code=0)
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"change.tif", "change.json", "report.html"}
    run(*words, code=3)
    assert run(*words, "--overwrite", "--quiet").output == ""


def test_the_record_of_a_diff_for_machines():
    done = run("diff", "may", "june", "--json", "--set", "min_tiles=3", "--set", "fdr=0.1")
    (line,) = [text for text in done.stdout.splitlines() if '"counts"' in text]
    record = json.loads(line)
    assert record["counts"]["changed"] >= 36
    assert record["files"] == []
    assert sum(map(sum, record["classes"]["tiles_before_after"])) == 1_200


def test_the_page_of_a_map_is_made_again_and_its_place_is_said():
    page = Path("field") / "report.html"
    before = page.read_bytes()
    page.unlink()
    done = run("report", "field", code=0)
    assert done.output.split() == ["Open", str(page), "in", "a", "browser."]
    assert page.read_bytes() == before
    assert run("report", "field", "--quiet").output == ""
    done = run("report", "field", "--json")
    assert json.loads(done.stdout.splitlines()[-1]) == {"report": str(page), "bytes": len(before)}


@pytest.mark.parametrize("point", ["crs:330004.5,2040004.5", "330004.5,2040004.5", "lonlat:{0},{1}"])
def test_a_crop_around_a_point_in_either_system(tmp_path, point):
    degrees = Transformer.from_crs(32614, 4326, always_xy=True).transform(330004.5, 2040004.5)
    words = ("--around", point.format(*degrees), "--radius", 2, "--datum", "crs:330000,2040000")
    done = run("export", "field", "--to", "nav2", "--out", tmp_path / "out", *words, "--json", code=0)
    record = json.loads(done.stdout)
    assert record["area"] == {"west": 0.0, "south": 0.0, "east": 9.0, "north": 9.0}
    assert record["resolution_m"] == pytest.approx(0.2)
    assert (tmp_path / "out" / "map.pgm").read_bytes().startswith(b"P5\n45 45\n255\n")


# --- route ---
def test_the_way_goes_through_the_gap_and_all_files_are_there(tmp_path):
    words = ["route", "layers", "--from", lonlat(20.5, 8.5), "--to", lonlat(20.5, 22.5), "--out", tmp_path / "way"]
    result = run(*words, code=0)
    files = {path.name: path.read_bytes() for path in (tmp_path / "way").iterdir()}
    views = {"map.qgs", "route.qml"}
    assert set(files) == {"route.geojson", "route.gpx", "profile.csv", "route.json", *views}
    assert "arrives" in result.stdout
    lines = pyogrio.read_dataframe(tmp_path / "way" / "route.geojson").to_crs("EPSG:32614")
    (line,) = lines.geometry[lines.geom_type == "LineString"]
    assert max(y for _, y in line.coords) > (SOUTH + ROWS - 3) * 3.0
    properties = json.loads(files["route.geojson"])["features"][0]["properties"]
    assert properties["length_m"] == pytest.approx(line.length, abs=0.02)  # 7 decimals of a degree
    again = run(*words, code=3)
    assert "--overwrite" in again.output
    wrong = run(*words, "--avoid", "none.geojson")
    assert "none.geojson" in wrong.output  # told before that the folder is occupied
    run(*words, "--overwrite", code=0)
    after = {path.name: path.read_bytes() for path in (tmp_path / "way").iterdir()}
    assert {name for name in files if files[name] != after[name]} <= {"route.json"}


def test_without_a_place_to_write_only_the_summary_is_printed(made):
    before = sorted(made.rglob("*"))
    result = run("route", "layers", "--from", place(20.5, 8.5), "--to", place(5.5, 8.5), code=0)
    assert sorted(made.rglob("*")) == before
    assert result.stdout.splitlines()[1].split()[:3] == ["route", "45", "1.00"]


def test_where_the_survey_is_too_thin_the_message_says_what_density_would_do(tmp_path):
    thin = site()
    seen = np.where(np.abs(thin.patches.col - WEST - 20) < 2, 0.69, 0.3).astype(np.float32)
    write_folder(tmp_path / "thin", replace(thin, smallest_object=seen))
    words = "route", tmp_path / "thin", "--from", place(5.5, 5.5), "--to", place(5.5, 25.5)
    done = run(*words)
    assert "if nothing narrower than 0.7 m stands in the way" in " ".join(done.stdout.split())
    (way,) = json.loads(run(*words, "--json").stdout)["routes"]
    assert way["smallest_object_m"] == pytest.approx(0.69)
    refused = run(*words, "--seen-width", "0.5", code=3)
    text = " ".join(refused.output.split())
    assert re.search(r"where objects of 0\.5 m would not be seen: that takes \d+ points/m2.* raise --seen-width", text)
    inside = run(*words[:3], place(5.5, 20.5), *words[4:], "--seen-width", "0.5")
    assert "objects of 0.5 m would not be seen, which --seen-width closes" in " ".join(inside.output.split())
    record = json.loads((tmp_path / "thin" / "run.json").read_text())
    assert "are not seen" in record["counts"]["seen_sizes"]["seen"]
    run("export", tmp_path / "thin", "--to", "nav2", "--out", tmp_path / "nav2", code=0)
    exported = json.loads((tmp_path / "nav2" / "datum.json").read_text())
    assert exported["seen"] == record["counts"]["seen_sizes"]["seen"]
    assert exported["seen"] in (tmp_path / "nav2" / "map.yaml").read_text()


def test_a_map_with_a_setting_and_a_raster_that_are_gone_is_read_like_one_without(tmp_path):
    """Earlier versions rated the ride by heading too."""
    old = copy_folder(Path("may"), tmp_path / "old", settings=RUN["settings"] | {"headings": True})
    (old / "rasters/headings.tif").write_bytes(b"is not read")
    list_anew(old, files=[*json.loads((old / "run.json").read_text())["files"], {"path": "rasters/headings.tif"}])
    written = []
    for number, layers in enumerate(("may", old)):
        out = tmp_path / str(number)
        for words in ("route", "--from", A, "--to", C), ("export", "--to", "nav2"):
            run(words[0], layers, *words[1:], "--out", out / words[0], code=0)
        written.append([(out / name).read_bytes() for name in ("route/route.geojson", "export/map.pgm")])
    assert written[0] == written[1]
    run("report", old, code=0)
    run("diff", old, "june", "--out", tmp_path / "diff", code=0)


# --- scan ---
def out_files(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_one_scan(tmp_path):
    out = tmp_path / "out"
    result = run("scan", "frame.ply", "--method", "filter", "--out", out, code=0)
    rows = [line.split() for line in result.stdout.splitlines()]
    table = pq.read_table(out / "sectors.parquet").to_pydict()
    vertices = read_vertices(out / "frames" / "frame.ply")
    for class_id, name in enumerate(("smooth", "fair", "rough")):
        row = next(row for row in rows if row[:2] == [str(class_id), name])
        assert int(row[2]) == table["class"].count(class_id)
        assert int(row[-1].replace(",", "")) == (vertices["class"] == class_id).sum()
    free = sum(own in (0, 1) and not held for own, held in zip(table["class"], table["obstacle"], strict=True))
    assert f"sectors: {free:,} free" in result.stdout
    assert f"{table['class'].count(None):,} not ground" in result.stdout
    assert f"Output in {out}: frames, sectors.parquet, scan.json" in result.stdout
    assert out_files(out) == ["frames/frame.ply", "scan.json", "sectors.parquet"]


def test_pictures_of_all_frames_or_of_every_nth_as_far_as_wanted(tmp_path):
    for number in range(3):
        write_bin(tmp_path / "drive" / f"{number}.bin", scanned(seed=number))
    words = ("--method", "filter", "--set", "products=table", "--overwrite", "--out", tmp_path / "out", "--pictures")
    pictures = {}
    for more in ((), ("2",), ("1", "--set", "range_m=10")):
        run("scan", tmp_path / "drive", *words, *more, code=0)
        pictures[more] = {path.name: path.read_bytes() for path in (tmp_path / "out" / "frames").iterdir()}
    everyone, second, near = pictures.values()
    assert list(map(sorted, pictures.values())) == [["0.png", "1.png", "2.png"], ["0.png", "2.png"], sorted(everyone)]
    assert all(everyone[name] == content for name, content in second.items())
    assert all(near[name] != content for name, content in everyone.items())


def test_a_drive_for_machines(tmp_path):
    drive, out = tmp_path / "drive", tmp_path / "out"
    for number in (2, 10):
        write_bin(drive / f"{number}.bin", scanned(seed=number))
    (tmp_path / "poses.txt").write_text("0 0 0 1 0 0 0 1\n1 1 0 1 0 0 0 1\n")
    words = ("--out", out, "--method", "filter", "--set", "products=table, cloud")
    result = run("scan", drive, "--poses", tmp_path / "poses.txt", "--json", *words, code=0)
    record = json.loads(result.stdout)
    assert record["frames"] == 2
    assert record["points"] == sum(record["points_by_class"].values())
    assert record["files"] == ["frames", "sectors.parquet", "gathered.laz", "scan.json"]
    assert Path(record["map"][0]) == out / "map" / "rasters" / "roughness.tif"
    assert {path.split("/")[0] for path in out_files(out)} == {*record["files"], "map"}
    assert list(dict.fromkeys(pq.read_table(out / "sectors.parquet")["frame"].to_pylist())) == ["2", "10"]
    assert "--overwrite" in run("scan", drive, "--quiet", "--out", out, code=3).stderr
    assert run("scan", drive, "--quiet", "--overwrite", *words, code=0).output == ""
    assert out_files(out) == ["frames/10.ply", "frames/2.ply", "scan.json", "sectors.parquet"]


def test_a_bad_frame_among_others(tmp_path):
    bad, out = tmp_path / "bad.ply", tmp_path / "out"
    bad.write_bytes(b"ply\nnonsense")
    run("scan", "frame.ply", bad, "--out", out, "--set", "threads=1", code=3)
    assert not list(out.glob("[!.]*"))  # what is finished waits in a hidden folder
    result = run("scan", "frame.ply", bad, "--out", out, "--skip-bad", code=4)
    assert "skipped frames: 1;" in result.stdout
    assert str(bad) in result.stderr
    assert "frames/frame.ply" in out_files(out)


# --- info ---
def dense(path, classes=None, *, crs="EPSG:32614", rows=slice(None), north=0.0):
    """Write 900 points over four full tiles, or some of them."""
    x, y = (axis.ravel()[rows] for axis in np.meshgrid(*2 * (np.arange(0.1, 6, 0.2),)))
    columns = {} if classes is None else {"classification": np.broadcast_to(np.uint8(classes), 900)[rows]}
    return write_las(path, 500001 + x, 4000002 + y + north, np.full(x.size, 10.0), crs=crs, **columns)


def test_the_classes_and_what_they_are_taken_for(tmp_path):
    classes = np.repeat(np.uint8([6, 4, 66, 7, 2]), [90, 90, 90, 9, 621])
    path = dense(tmp_path / "a.laz", classes)
    found = json.loads(run("info", path, "--json").stdout)["files"][0]
    assert found["classes"] == {"2": 621, "4": 90, "6": 90, "66": 90}  # noise is left out
    assert (found["points_promised"], found["points"], found["tiles"]) == (900, 891, 4)
    assert found["dropped"] == {"withheld": 0, "noise": 9, "not_a_number": 0}
    assert found["unknown_tiles_about"] == {}
    assert found["needs"] == [f"ready, about 0% of the tiles will be unknown: bumpymap map {path} --out DIR"]


def test_what_was_given_is_in_the_command_and_units_in_the_record(tmp_path):
    path = dense(tmp_path / "a b.las", crs=None)
    said = run("info", path, "--crs", "EPSG:32614", "--set", "z_unit=m", "--ground", "all", "--quick").output
    assert f"ready: bumpymap map '{path}' --crs EPSG:32614 --z-unit m --ground all --out DIR" in said
    result = run("info", path, "--crs", "EPSG:2992", "--set", "z_unit=m", "--json")
    (record,) = json.loads(result.stdout)["files"]
    assert record["epsg"] == 2992
    assert (record["metres_per_unit"], record["metres_per_unit_z"]) == (0.3048, 1.0)
    assert record["bounds_crs_units"][0] == pytest.approx(500001.1)
    assert record["bounds_m"][0] == pytest.approx(500001.1 * 0.3048)


def test_quick_reads_no_points(tmp_path, monkeypatch):
    path = dense(tmp_path / "a.laz")
    monkeypatch.setattr(laspy.LasReader, "read_points", None)
    result = run("info", path, "--quick", code=0)
    assert "900 according to the header" in result.output
    assert "26.8 pts/m2 in the header's extent" in result.output  # 900 / 5.8**2


def test_several_files_are_told_together_and_a_bad_one_is_an_error(tmp_path):
    good = dense(tmp_path / "a.laz", 1, rows=slice(0, None, 2))
    bad = dense(tmp_path / "b.laz", 1, rows=slice(1, None, 2))
    said = run("info", tmp_path, "--crs", "EPSG:32614").output
    assert "together: about 0% of the tiles will be unknown" in said
    assert f"one map: bumpymap map {tmp_path} --crs EPSG:32614 --out DIR" in said
    bad.write_bytes(bad.read_bytes()[:-50])
    result = run("info", tmp_path, code=3)
    assert re.search(f"ready, about .*: bumpymap map {good}", result.output)
    assert f"error: {bad}" in result.output
    record = json.loads(run("info", tmp_path, "--json").stdout)["files"][1]
    assert record["path"] == str(bad)
    assert "truncated" in record["error"]


@pytest.mark.parametrize("quick", [[], ["--quick"]])
def test_a_site_larger_than_one_map_is_told_before_and_refused_by_map(tmp_path, quick):
    folder = tmp_path / "site"
    south, north = dense(folder / "south.las"), dense(folder / "north.las", north=400_000.0)
    report = " ".join(run("info", folder, *quick).output.split())
    assert "too large: the survey spans 0.0 km x 400.0 km" in report
    assert "separate runs, whose rasters lie on one grid, or give larger tiles with --tile-size" in report
    assert json.loads(run("info", folder, *quick, "--json").stdout)["too_large"].startswith("the survey spans")
    assert json.loads(run("info", south, *quick, "--json").stdout)["too_large"] == ""
    refused = run("map", folder, "--out", tmp_path / "out", code=3)
    said = " ".join(refused.output.split())
    assert "the survey spans 0.0 km x 400.0 km" in said
    assert f"The files read are: {north}, {south}" in said


ROOT = Path(__file__).resolve().parents[2]


def events(text):
    found = [json.loads(line) for line in text.splitlines()]
    times = [datetime.fromisoformat(event.pop("time")) for event in found]
    assert all(time.utcoffset().total_seconds() == 0 for time in times)
    assert times == sorted(times)
    return found


def test_events_hold_the_same(capsys):
    now = [1000.0]
    progress = _output.TickedProgress(lambda: now[0], as_json=True)
    progress.start("reading points", 1000)
    progress.advance(250)
    now[0] += 12.34
    progress.tick()
    progress.start("timing", None)
    progress.tick()
    progress.note("text", "epoch", epoch=1, loss=0.5)
    assert events(capsys.readouterr().err) == [
        {"event": "stage", "stage": "reading points", "total": 1000},
        {"event": "progress", "stage": "reading points", "done": 250, "total": 1000, "share": 0.25, "seconds": 12.3},
        {"event": "stage", "stage": "timing", "total": None},
        {"event": "progress", "stage": "timing", "done": 0, "total": None, "share": None, "seconds": 12.3},
        {"event": "epoch", "epoch": 1, "loss": 0.5},
    ]


def test_a_run_in_events(tmp_path):
    survey = write_survey(tmp_path / "a.laz")
    result = run("map", survey, "--out", tmp_path / "o", "--json", code=0)
    found = events(result.stderr)
    kinds = [event["event"] for event in found if event["event"] != "info"]
    assert kinds == ["start", *4 * ["stage"], "done"]
    assert found[0]["arguments"] == ["map", str(survey), "--out", str(tmp_path / "o"), "--json"]
    assert found[-1]["exit_code"] == 0
    assert json.loads(result.stdout)["points"] == 20_000


@pytest.mark.parametrize(
    ("words", "code", "kind"),
    [
        (["map", "--none", "--json"], 2, "NoSuchOption"),
        (["map", "a.laz", "--json"], 2, "UsageError"),
        (["map", "a\x1b\n.laz", "--out", "o", "--json"], 3, "BadInputError"),
        (["nothing", "--json"], 2, "NoSuchCommand"),
    ],
)
def test_the_last_event_of_a_failure(tmp_path, monkeypatch, words, code, kind):
    monkeypatch.chdir(tmp_path)
    *_, last = events(run(*words, code=code).stderr)
    assert (last["event"], last["exit_code"]) == ("error", code)
    assert last["message"]
    assert last["kind"] == kind or kind.startswith("NoSuch")  # older click has one name for these


def test_what_stands_after_two_dashes_is_no_option_and_a_fault_is_an_event_with_its_traceback(capsys):
    def fail(error):
        raise error

    assert exit_code_of(lambda: fail(BadInputError("no")), ["map", "--", "--json"]) == 3
    assert capsys.readouterr().err == "Error: no\n"
    with pytest.raises(KeyError):
        exit_code_of(lambda: fail(KeyError("x")), ["map"])
    assert exit_code_of(lambda: fail(KeyError("x")), ["map", "--json"]) == 1
    last = events(capsys.readouterr().err)[-1]
    assert (last["event"], last["kind"], "Traceback" in last["traceback"]) == ("error", "KeyError", True)


def test_a_command_leaves_the_log_of_its_caller_alone(tmp_path):
    log = logging.getLogger("bumpymap")
    before = list(log.handlers), log.level, log.propagate
    for words in (["info", tmp_path / "none.laz"], ["map", "a.laz", "--json"], ["info", QUARRY, "--quick"]):
        run(*words)
        assert (list(log.handlers), log.level, log.propagate) == before


# --- foreign text ---
WICKED = (
    "a\x1b[31m\x1b]0;owned\x07 b\nError: c\r\t\x7f\x9b \u202egnp \u2066 \u2028 \u200f \udcff [red]d[/red] :smile: é 道"
)


def nothing_acts(text):
    """Whether every line holds nothing that a terminal acts on."""
    return all(unicodedata.category(letter) not in {"Cc", "Cf", "Cs", "Zl", "Zp"} for letter in text.replace("\n", ""))


def test_no_letter_acts():
    for letter in map(chr, [*range(0x3000), *range(0xD800, 0xE000), *range(0xE0000, 0xE0100)]):
        shown = escape_controls(f"a{letter}b")
        assert (shown[0], shown[-1]) == ("a", "b")
        assert nothing_acts(shown) and "\n" not in shown, hex(ord(letter))  # noqa: PT018 (many times)


def test_every_way_out_shows_it(capsys):
    print_line(WICKED, "bold")
    print_table([(WICKED, WICKED)])
    print_table([(WICKED, WICKED)], ["one", "two"])
    print_json({"name": WICKED})
    print_error(WICKED)
    out, err = capsys.readouterr()
    with _output.moving_bars(Console(file=(bar := io.StringIO()), force_terminal=True, width=400)) as bars:
        bars.start(WICKED, 3)
        bars.advance(2)
    assert "2/3" in bar.getvalue()
    assert escape_controls(WICKED) in bar.getvalue()
    assert nothing_acts(out)
    assert nothing_acts(err)
    assert out.splitlines()[0] == err.rstrip("\n") == escape_controls(WICKED)
    assert "[red]d[/red] :smile:" in err
    assert json.loads(out.splitlines()[-1])["name"] == WICKED


def test_an_encoding_without_the_letters(monkeypatch):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, "ascii"))
    print_line("é 道")
    assert raw.getvalue() == b"\\xe9 \\u9053\n"


def test_lines_of_a_message_stay_lines(tmp_path):
    for name in ("a.laz", "b\nError: forged.laz"):
        (tmp_path / name).write_bytes(b"LASFnothing")
    result = run("map", tmp_path, "--out", tmp_path / "o", "--skip-bad", code=3)
    assert "forged" in result.stderr
    assert not any(line.startswith("Error: forged") for line in result.stderr.splitlines())
    found = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    assert found == ["Error: none of the inputs could be read:"]
