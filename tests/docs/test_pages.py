"""What the pages say of commands, settings, tables, columns and extras is so, and their Python runs as it stands."""

import importlib.util
import json
import re
import sys
import tomllib
from dataclasses import fields
from pathlib import Path

import click
import numpy as np
import pytest
from classed_site import scan_fixture  # noqa: F401 (found by pytest)
from made_drives import write_drive
from route_maps import write_folder

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
PAGES = ROOT / "docs" / "pages"
COMMANDS = main.list_commands(click.Context(main))


def text_of(page):
    return (PAGES / page).read_text(encoding="utf-8")


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
    filled = "".join(reference.on_page_markdown(text_of(page.name)) for page in sorted(PAGES.glob("*.md")))
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
    page = PAGES / "ride-cost.md"
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
