"""What the pages say of commands, settings, tables and columns is so; their commands and Python run as they stand.

Each page has a folder of its own with the files that its commands name.
"""

import importlib.util
import json
import re
import shlex
import shutil
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import click
import laspy
import numpy as np
import pytest
import rasterio
from bags import cloud, lidar_rows, odometry, write_bag
from classed_site import scan_fixture  # noqa: F401 (found by pytest)
from made_drives import MadeDrive, churned_field, log_of, write_bin, write_drive, write_table
from pypcd4 import Encoding, PointCloud
from rasterio.windows import Window
from route_maps import write_folder
from scipy.spatial.transform import Rotation
from small_surveys import run, write_las

import bumpymap
from bumpymap.cli import main
from bumpymap.core import BANDS, BARRED_TEXT, CLASS_NAMES, OBJECT_NAMES, REASON_TEXT, UsageError, read_settings_file
from bumpymap.core.config import MapConfig
from bumpymap.lab import CalibrationSettings, calibration_jobs
from bumpymap.layers import CLASS_COLOURS, SurveyRow
from bumpymap.layers.placement import MAX_PIXELS, MAX_TILES
from bumpymap.layers.scan_folder import COLUMNS, SCAN_CLASS_NAMES, SCAN_COLOURS
from bumpymap.rating import Vehicle
from bumpymap.readers.drive_signals import NAMES, QUANTITIES, UNITS, parse_columns
from bumpymap.scan.config import SCAN_PRODUCTS, ScanConfig
from bumpymap.scan.pipeline import scan_frames
from bumpymap.survey.batch.run import list_surveys

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "pages"
COMMANDS = main.list_commands(click.Context(main))


def text_of(page):
    return (FOLDER / page).read_text(encoding="utf-8")


def script(*path):
    """Load a script under docs."""
    spec = importlib.util.spec_from_file_location(f"docs_{path[-1]}", ROOT.joinpath("docs", *path).with_suffix(".py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look for their module
    spec.loader.exec_module(module)
    return module


def command(name):
    return main.get_command(click.Context(main), name)


# --- the reference and the commands ---
def test_the_reference_shows_the_help_of_every_command():
    shown = set(re.findall(r"^<!-- help ([a-z ]+) -->$", text_of("command-line.md"), re.MULTILINE))
    parts = {f"{name} {part}" for name in ("evaluate", "train") for part in command(name).commands}
    assert shown == set(COMMANDS) - {"evaluate", "train"} | parts | {"vehicle new"}


def test_the_reference_is_filled_from_the_declarations():
    reference = script("reference")
    filled = "".join(reference.on_page_markdown(text_of(page.name)) for page in sorted(FOLDER.glob("*.md")))
    assert not re.search("<!-- (help|settings|bands|columns|profile|vehicles|include)", filled)
    for number, band in enumerate(BANDS, start=1):
        assert f"| {number} | `{band.name}` | {band.unit} | {band.description} |" in filled
        assert f"| `{band.name}` | " in filled
    assert all(f"| `{name}` | " in filled for name, *_ in COLUMNS)
    assert "| `chassis.com_height_m` | m | -2 to 6 | height of the centre of mass" in filled
    assert re.search(r"\| `rocker.stiffness_nm_per_rad` \| 120000 \| 5000 \| 300 \| 10000 \|", filled)
    assert "| affine | BSD | default |" in filled
    assert re.search(r"--tile-size M +Side of a tile, in metres \[3\]\.", filled)
    assert "#pixels = 15" in filled


def test_the_settings_of_the_page_are_settings(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", text_of("command-line.md"), re.DOTALL)
    (tmp_path / "a.toml").write_text(text)
    config = MapConfig((), tmp_path, **read_settings_file(tmp_path / "a.toml", MapConfig))
    assert config.crs == "EPSG:32614"
    assert config.features == MapConfig((), tmp_path).features


def test_the_first_page_lists_the_extras():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    rows = re.findall(r"^\| `(\w+)` \| .* \| (.*) \|$", text_of("index.md"), re.MULTILINE)
    listed = {name: set(brings.split(", ")) for name, brings in rows}
    named = {name: {re.split(r"[\[>=]", wanted)[0] for wanted in wants} for name, wants in extras.items()}
    del named["all"]
    assert set(re.search(r"\[(.*)\]", extras["all"][0])[1].split(",")) == set(named)
    assert {name: listed[name] for name in named} == named


# --- many surveys ---
BATCH = text_of("batch.md")


def test_the_columns_of_the_summary_are_described_in_their_order():
    rows = BATCH.split("| column | meaning |")[1].split("\n\n")[0].splitlines()
    described = [name for row in rows if row.startswith("| `") for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert described == [column.name for column in fields(SurveyRow)]


def test_the_columns_of_a_table_are_described_and_the_example_is_one(tmp_path):
    (named,) = re.findall(r"The\s+columns are (.*?)\.\s", BATCH, re.DOTALL)
    columns = re.findall(r"`(\w+)`", named)
    table = tmp_path / "a.csv"
    table.write_text("survey,nonsense", encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        list_surveys(table, "file")
    assert sorted(str(caught.value).split("there are: ")[1].split(", ")) == sorted(["survey", "name", *columns])
    (tmp_path / "2026-05-03").mkdir()
    for name in ("north", "south"):
        (tmp_path / "2026-05-03" / f"{name}.laz").touch()
    (example,) = re.findall(r"```text\n(survey,.*?)```", BATCH, re.DOTALL)
    table.write_text(example, encoding="utf-8")
    north, south = list_surveys(table, "file")
    assert north == (tmp_path / "2026-05-03" / "north.laz", "north", {"crs": "EPSG:32614"})
    assert south[2] == {"crs": "EPSG:32615", "ground": "csf", "vehicle": "car"}


# --- logs of drives ---
LOGS = text_of("check.md")
TABLE = [line.split("|") for line in LOGS.split("| quantity | what |")[1].split("\n\n")[0].splitlines()[2:]]


def test_every_quantity_has_a_row_and_names_on_the_page_are_known():
    assert sorted(name for row in TABLE for name in re.findall(r"`(\w+)`", row[1])) == sorted(QUANTITIES)
    for row in TABLE:
        named = re.findall(r"`(\w+)`", row[3])
        assert {NAMES[name.lower()] for name in named} <= set(re.findall(r"`(\w+)`", row[1]))


def test_units_and_examples_of_columns_on_the_page_are_read():
    rows = LOGS.split("| quantity | units |")[1].split("\n\n")[0].splitlines()[2:]
    listed = [row.split("|")[2].strip().split(", ") for row in rows]
    assert sorted(map(sorted, listed)) == sorted(sorted(units) for name, units in UNITS.items() if name != "number")
    examples = re.findall(r"--columns ([^\s`]*=[^\s`]*)", LOGS)
    assert len(examples) == 3
    assert all(parse_columns(text) for text in examples)


# --- the surfaces of real drives ---
boreal = script("drives", "borealtc")
SURFACES = text_of("ride-cost.md")


def test_the_surfaces_that_pages_show_are_those_of_the_whole_set():
    known = json.loads((ROOT / "bumpymap" / "views" / "page" / "data" / "surfaces.json").read_text(encoding="utf-8"))
    assert {one["name"]: one["c_r"] for one in known["surfaces"]} == boreal.WHOLE_SET
    assert all(f"{c_r:.3f}" in SURFACES for c_r in boreal.WHOLE_SET.values())


@pytest.mark.realdata
def test_the_real_drives_give_the_figures_of_the_page(shared_data, capsys):
    boreal.main(shared_data / "drives" / "borealtc")
    printed = capsys.readouterr().out
    assert len([line for line in printed.splitlines() if line.startswith("|") and "---" not in line]) == 44
    (table,) = (part for part in printed.split("\n\n") if part.startswith("| surface | way, m |"))
    assert len(table.splitlines()) == 7  # head, line, 5 surfaces
    assert table in SURFACES


# --- Python ---
API = text_of("api.md")


def test_calibrate_makes_as_many_drives_as_the_page_says():
    page = FOLDER / "ride-cost.md"
    whole = CalibrationSettings(Vehicle.load("warthog"))
    numbers = [sum(job.starts for job in calibration_jobs(settings)) for settings in (whole, whole.quick())]
    assert re.findall(r"([\d,]+) drives will|makes ([\d,]+) drives", page.read_text(encoding="utf-8")) == [
        (f"{numbers[0]:,}", ""),
        ("", f"{numbers[1]:,}"),
    ]


def test_every_public_name_is_on_the_page():
    assert set(re.findall(r"^::: bumpymap\.(\w+)$", API, re.MULTILINE)) == set(bumpymap.__all__) - {"__version__"}


@pytest.fixture(scope="module")
def site_layers(tmp_path_factory):
    return bumpymap.map_survey(ROOT / "sample_data" / "quarry.laz", tmp_path_factory.mktemp("site") / "site_layers")


@pytest.mark.slow
@pytest.mark.parametrize("part", ["notebook", "calls"])
def test_the_python_of_the_page_runs(part, site_layers, tmp_path, monkeypatch):
    """Block after block, as it stands: the notebook at its begin, then the calls."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    (tmp_path / "sample_data").symlink_to(ROOT / "sample_data")
    for name in ("site_layers", "may_layers", "june_layers"):
        (tmp_path / name).symlink_to(site_layers.folder)
    rows = [line.split(",") for line in write_drive(tmp_path / "monday.csv").read_text("utf-8").splitlines()]
    for name, columns in (("imu.csv", slice(0, 7)), ("gnss.csv", slice(7, None))):
        lines = [",".join([row[0], *row[columns][columns.start == 0 :]]) for row in rows]
        (tmp_path / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    calls = API.index("\n## Map a survey\n")
    blocks = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL).finditer(API)
    names = {}
    for block in (block for block in blocks if (block.start() < calls) == (part == "notebook")):
        line = API.count("\n", 0, block.start()) + 1
        exec(compile("\n" * line + block[1], "api.md", "exec"), names)  # noqa: S102 (our own page)
    assert names
    if part == "notebook":
        check_notebook(names, matplotlib.image.imread(tmp_path / "notebook.png"))


def check_notebook(names, picture):
    """The numbers that the page speaks of, and the picture."""
    assert repr(names["layers"]) in API
    assert list(names["statistics"].index) == ["smooth", "fair", "rough", "very rough"]
    assert names["statistics"]["c_r"].is_monotonic_increasing
    dearest_shown = names["cheapest"]["cost"].max()
    assert (names["tiles"]["cost"] < dearest_shown).sum() < 5
    assert 0 < names["passable"].area.sum() < names["regions"].area.sum()
    assert set(names["scan"].sector_class.tolist()) > {0, 255}
    assert picture.shape[:2] == (400, 1200)
    assert len({tuple(pixel) for pixel in picture[::4, ::4].reshape(-1, 4).tolist()}) > 50


# ---- files, GIS and scans ----


FILES, GIS, SCANS = (text_of(f"{name}.md") for name in ("files", "gis", "scans"))


def blocks(page, language="python"):
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


@pytest.fixture(scope="module")
def made_map(tmp_path_factory, cost_map):
    return write_folder(tmp_path_factory.mktemp("docs") / "OUT", cost_map, views=True).parent


@pytest.fixture(scope="module")
def made_scan(tmp_path_factory, scan):
    folder = tmp_path_factory.mktemp("docs")
    (folder / "drive").mkdir()
    np.column_stack([scan.points, scan.intensity]).astype("<f4").tofile(folder / "drive" / "NAME.bin")
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    scan_frames(ScanConfig((folder / "drive",), folder / "OUT", poses=folder / "poses.txt"))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "snippet"),
    [(made, text) for made, page in (("made_map", FILES + GIS), ("made_scan", SCANS)) for text in blocks(page)],
)
def test_snippet_runs(request, monkeypatch, made, snippet):
    monkeypatch.chdir(request.getfixturevalue(made))
    names = {}
    exec(compile(snippet, "snippet", "exec"), names)  # noqa: S102 (our own page)
    assert any(not name.startswith("__") for name in names)


def test_tables_say_what_the_code_writes():
    for value, name in enumerate(CLASS_NAMES):
        assert f"| {value} | {name} | `#{bytes(CLASS_COLOURS[value][:3]).hex()}` |" in FILES
    for names in (REASON_TEXT, BARRED_TEXT, dict(enumerate(OBJECT_NAMES))):
        for value, text in names.items():
            assert f"| {int(value)} | {text} |" in FILES
    assert f"{MAX_TILES:,} tiles" in FILES
    assert f"{MAX_PIXELS:,} heightmap pixels" in FILES
    for name, colour in zip((*SCAN_CLASS_NAMES[:3], "obstacle", "not ground"), SCAN_COLOURS, strict=True):
        assert f"| {name} | `#{bytes(colour).hex()}` |" in SCANS
    assert ", ".join(f"`{product}`" for product in SCAN_PRODUCTS) in SCANS


def test_the_settings_of_the_page_of_scans_are_settings(tmp_path):
    (text,) = blocks(SCANS, "toml")
    (tmp_path / "a.toml").write_text(text)
    config = ScanConfig(**read_settings_file(tmp_path / "a.toml", ScanConfig))
    assert config.polar == ScanConfig((), tmp_path).polar
    assert config.robot.box_m == (-1.2, 0.4, -0.5, 0.5)


WHOLE_PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs" / "pages").glob("*.md")))
PROGRAMS = (
    "bumpymap", "chmod", "dask", "grass", "make", "openssl", "pip", "python", "sudo",
)  # fmt: skip
SHELL = {"", "bash", "console", "sh", "shell"}
CRS = "EPSG:32614"


RULES = {
    r"^(\S*python -m )?pip install": "downloads; the extras that it names are held to pyproject.toml",
    r"^\. \.venv/bin/activate$": "changes the shell; `make demo` makes the environment",
    r"^make ": ".ci/run and .ci/fresh-machine run it; the target is held to the Makefile",
    r"^sudo apt-get ": "changes the system; .ci/run installs the same packages",
    r"^dask |scheduler=|^export DASK_": "takes a cluster: tests/survey/engine/test_cluster.py has one",
    r"^(openssl|chmod) ": "makes keys: tests/survey/engine/test_cluster.py runs them",
    r"^grass ": "takes GRASS",
    r"^(xdg-open|qgis) ": "opens a window",
    r"^python docs/licences/": "writes a page anew; a test of its own holds it",
    r"^python tests/tools/faults\.py": "runs tests for every fault, for an hour",
    r"^python tests/tools/tables\.py": "tests/lab/test_tables.py runs it",
    r"^python tests/tools/speed\.py": "measures for a minute or more, and means little beside other tests",
    r"^python tests/tools/driven\.py": "an hour of drives",
    r"^bumpymap settings |--config map\.toml": "writes a file that is to be edited",
    r"^python tests/fuzz/": "an hour",
    r"^python docs/pictures/": "draws over a picture of the pages; takes minutes",
    r"^bumpymap vehicle new ": "writes the profile that later commands want filled in",
    r"^bumpymap calibrate ": "hours of drives",
    r"^\S*python \.ci/refresh_constraints\.py": "asks the package index for every file",
    r"^python docs/drives/": "takes a data set; tests/docs/test_pages.py runs it where that is",
    r"--refit ": "takes hundreds of metres of drives: tests/cli/test_options.py makes them",
    r"--calibration small\.json": "takes a calibration for such tiles: hours of drives",
    r"^python tests/benchmarks/": "measures for minutes or hours, some beside other programs; tests run parts",
    r"^python docs/models/|model=rellis\.onnx": "takes open3d, a data set or minutes",
    r"^bumpymap (evaluate|train) ": "hours of drives or learning; tests/lab runs short ones",
}
"""What does not simply run in the suite, as patterns of commands, and why."""


def shown(page: Path) -> Iterator[str]:
    """Give the commands of a page in their order: of its blocks, and those in its sentences that name a file."""
    text = page.read_text(encoding="utf-8")
    found: list[tuple[int, str]] = []
    for block in re.finditer(r"(?ms)^( *)```(\S*)[^\n]*\n(.*?)^\1```", text):
        program = block[3].strip().removeprefix("$ ").partition(" ")[0]
        if block[2] in SHELL and (block[2] or program in PROGRAMS):  # a block of no language may be a formula
            found += [(block.start(), line) for line in _lines(block[3])]
    begin = "|".join(PROGRAMS)
    found += [(line.start(), line[1]) for line in re.finditer(rf"(?m)^    ((?:{begin}) .*)$", text)]
    found += [(word.start(), word[1]) for word in re.finditer(r"`((?:\S*python \S+/|make |sudo\s)[^`]+)`", text)]
    for _, line in sorted(found, key=lambda one: one[0]):
        plain = line if "<<" in line else shlex.join(shlex.split(" ".join(line.split()), comments=True))
        yield plain.replace(".venv/bin/bumpymap", "bumpymap")


def _lines(block: str) -> list[str]:
    """Give the commands of a block: continued lines and what follows ``<<'END'`` belong to one."""
    block = re.sub(r"\\\n\s*", " ", block)
    block = re.sub(r"(?ms)^[^\n]*<<'?(\w+)'?\n.*?^\1$", lambda whole: whole[0].replace("\n", "\0"), block)
    prompted = any(line.strip().startswith("$ ") for line in block.splitlines())
    lines = [line.strip() for line in block.splitlines()]
    lines = [line.removeprefix("$ ") for line in lines if not prompted or line.startswith("$ ")]
    return [line.replace("\0", "\n") for line in lines if line and not line.startswith("#")]


def filled(command: str) -> list[str]:
    """Put files that are there in the place of words in capitals."""
    words = {"SURVEY": "site.laz", "DIR": "dir", "EPSG:CODE": CRS, "FOLDER": "folder", "YOUR_SURVEY.laz": "site.laz"}
    return [words.get(word, word) for word in shlex.split(command)]


def furnish(folder: Path) -> None:
    """Put the files there that commands name: small surveys, frames of a drive, a vehicle of one's own."""
    data, samples = ROOT / "bumpymap" / "rating" / "data", ROOT / "sample_data"
    run("map", samples / "quarry.laz", "--out", folder / "demo_out" / "layers", "--quiet")
    (folder / "sample_data").mkdir()
    for name in ("quarry.laz", "quarry_drive_imu.csv", "quarry_drive_gnss.csv"):
        shutil.copy(samples / name, folder / "sample_data")
    survey = laspy.read(samples / "quarry.laz")
    x, y, z = (np.asarray(axis) for axis in (survey.x, survey.y, survey.z))
    for name, east in (("site.laz", 0.0), ("flights/1.laz", 0.0), ("flights/2.laz", 12.0)):
        near = (abs(x - np.median(x) - east) < 6) & (abs(y - np.median(y)) < 9)
        classes = {"classification": np.asarray(survey.classification)[near]}
        write_las(folder / name, x[near], y[near], z[near], crs=CRS, offset=survey.header.offsets, **classes)
    for name in ("survey.laz", "may.laz", "june.laz"):
        shutil.copy(folder / "site.laz", folder / name)
    odm = folder / "odm_project"
    for name in ("odm_georeferencing/odm_georeferenced_model.laz", "odm_orthophoto/odm_orthophoto.tif"):
        (odm / name).parent.mkdir(parents=True)
    shutil.copy(folder / "site.laz", odm / "odm_georeferencing" / "odm_georeferenced_model.laz")
    kinds = {"ortho": ("odm_project/odm_orthophoto/odm_orthophoto.tif", "ortho.tif"), "dsm": ("dsm.tif", "dtm.tif")}
    for kind, names in kinds.items():
        shutil.copy(samples / f"quarry_{kind}.tif", folder / "sample_data")
        with rasterio.open(samples / f"quarry_{kind}.tif") as raster:
            values = raster.read(window=Window(0, 0, raster.width // 2, raster.height // 2))
            about = raster.profile | {"crs": CRS, "width": values.shape[2], "height": values.shape[1]}  # as site.laz
        for name in names:
            with rasterio.open(folder / name, "w", **about) as raster:
                raster.write(values)
    local = np.column_stack([x, y, z])[near] - (np.median(x), np.median(y), np.median(z))
    PointCloud.from_xyz_points(local.astype(np.float32)).save(str(folder / "slam.pcd"), Encoding.BINARY)
    _drive(folder)
    for name in ("my_vehicle", "my_robot"):
        shutil.copy(data / "vehicles" / "small_rover.toml", folder / f"{name}.toml")
        shutil.copy(data / "calibrations" / "small_rover.json", folder / f"{name}.json")
    for name in ("own.onnx", "scan.onnx"):
        shutil.copy(next((ROOT / "bumpymap" / "scan" / "data" / "models").glob("scan*.onnx")), folder / name)


def _drive(folder: Path) -> None:
    """Write frames of a robot that goes ahead, over ground that is smooth on one side, and their poses."""
    for frame in range(3):
        write_bin(folder / "drive" / f"{frame:06d}.bin", churned_field(frame))
    (folder / "poses.txt").write_text("".join(f"1 0 0 {frame} 0 1 0 0 0 0 1 0\n" for frame in range(3)))
    points = np.fromfile(folder / "drive" / "000000.bin", "<f4").reshape(-1, 4)[:, :3]
    PointCloud.from_xyz_points(points).save(str(folder / "frame.pcd"), Encoding.BINARY)
    _bag(folder)
    log, _, _ = log_of(MadeDrive(seconds=38.0, turning=0.5, noise=1e-3, place_white=0.02, mount_deg=(1.0, -2.0, 1.0)))
    write_table(folder / "drive.csv", log, (512_352.0, 5_403_239.0))


def _bag(folder: Path) -> None:
    """Write the frames and poses of the drive to a bag."""
    messages = []
    for number, file in enumerate(sorted((folder / "drive").iterdir())):
        points = np.fromfile(file, "<f4").reshape(-1, 4)[:, :3]
        pose = Rotation.identity(), (float(number), 0.0, 0.0)
        time_ns = 1_700_000_000_000_000_000 + number * 500_000_000
        messages.append(("/odom", time_ns, odometry(time_ns, pose, child="lidar")))
        messages.append(("/points", time_ns, cloud(lidar_rows(points), time_ns)))
    bag = write_bag(folder / "bag", messages)
    (bag / "bag.mcap").rename(folder / "drive.mcap")
    shutil.rmtree(bag)


SHOWN = [(page.name, command) for page in WHOLE_PAGES for command in shown(page)]
RUN = [(page, command) for page, command in SHOWN if not any(re.search(rule, command) for rule in RULES)]
OF_README = {command for page, command in RUN if page == "README.md"}
RUN_PAGES = ["README.md", *sorted({page for page, command in RUN if command not in OF_README} - {"README.md"})]


@pytest.fixture(scope="module")
def furnished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("furnished")
    furnish(folder)
    return folder


@pytest.mark.usefixtures("batches_here")
@pytest.mark.slow
@pytest.mark.parametrize("page", RUN_PAGES)
def test_the_commands_of_a_page_run_one_after_the_other(page, furnished, tmp_path, monkeypatch):
    folder = shutil.copytree(furnished, tmp_path / "page")
    monkeypatch.chdir(folder)
    outputs = []
    for command in (command for where, command in RUN if where == page):
        program, *words = filled(command)
        assert program == "bumpymap", f"no rule says what to do with: {command}"
        done = run(*words, code=0)
        outputs.append(done.output)
    if page == "routes.md":  # it shows what its second command prints
        assert said(shown_output(page)) == said(outputs[1])


def shown_output(page: str) -> str:
    """Give the first block of plain text of a page."""
    return re.search(r"(?ms)^```text\n(.*?)^```", (ROOT / "docs" / "pages" / page).read_text(encoding="utf-8"))[1]


def said(text: str) -> str:
    """Give a text without the time that a run took and how the command is called here, and its lines joined."""
    return " ".join(re.sub(r"(?m), [\d.]+ s$|(?<=yours: ).* map", "", text).split())


@pytest.mark.slow
def test_the_first_page_shows_what_the_demo_prints(furnished, monkeypatch):
    monkeypatch.chdir(furnished)
    assert said(shown_output("first-map.md")) == said(run("demo", "--out", "demo_out").output)


OWN = [(page, line) for page, line in SHOWN if line.startswith("bumpymap ") and not line.startswith("bumpymap --")]


@pytest.mark.slow
@pytest.mark.parametrize(("page", "line"), OWN)
def test_every_command_that_is_shown_can_be_given(page, line):
    _, name, *words = shlex.split(re.sub(r" > \S+", "", line))
    given = main.get_command(click.Context(main), name)
    if isinstance(given, click.Group):
        given = given.commands[words.pop(0)]
    given.make_context(name, words)


@pytest.mark.slow
def test_what_does_not_run_names_extras_targets_and_scripts_that_are_there():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    targets = re.findall(r"(?m)^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"))
    for page, command in SHOWN:
        for extras in re.findall(r"'\.\[([^\]]*)\]'", command):
            assert set(extras.split(",")) <= set(project["optional-dependencies"]), f"{page}: {command}"
        words = command.split()
        if words[0] == "make":
            assert {word for word in words[1:] if "=" not in word} <= set(targets), f"{page}: {command}"
        if words[0].endswith("python") and words[1].endswith(".py"):
            assert (ROOT / words[1]).is_file(), f"{page}: {command}"
