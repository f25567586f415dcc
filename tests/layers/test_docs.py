"""The pages about files, GIS and scans: snippets run, tables say what the code does."""

import re
from pathlib import Path

import numpy as np
import pytest
from route_maps import write_folder

from bumpymap.core.settings import read_settings_file
from bumpymap.core.types import BARRED_TEXT, CLASS_NAMES, OBJECT_NAMES, REASON_TEXT
from bumpymap.layers.colours import CLASS_COLOURS
from bumpymap.layers.placement import MAX_PIXELS, MAX_TILES
from bumpymap.layers.scan_folder import SCAN_CLASS_NAMES, SCAN_COLOURS
from bumpymap.scan.config import SCAN_PRODUCTS, ScanConfig
from bumpymap.scan.pipeline import scan_frames

pytestmark = pytest.mark.slow

FILES, GIS, SCANS = (
    (Path(__file__).resolve().parents[2] / "docs" / "pages" / f"{name}.md").read_text("utf-8")
    for name in ("files", "gis", "scans")
)


def blocks(page, language="python"):
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


@pytest.fixture(scope="module")
def made_map(tmp_path_factory, cost_map):
    return write_folder(tmp_path_factory.mktemp("docs") / "OUT", cost_map).parent


@pytest.fixture(scope="module")
def made_scan(tmp_path_factory, scan):
    folder = tmp_path_factory.mktemp("docs")
    (folder / "drive").mkdir()
    np.column_stack([scan.points, scan.intensity]).astype("<f4").tofile(folder / "drive" / "NAME.bin")
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    scan_frames(ScanConfig((folder / "drive",), folder / "OUT", poses=folder / "poses.txt"))
    return folder


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


def test_the_settings_of_the_page_are_settings(tmp_path):
    (text,) = blocks(SCANS, "toml")
    (tmp_path / "a.toml").write_text(text)
    config = ScanConfig(**read_settings_file(tmp_path / "a.toml", ScanConfig))
    assert config.polar == ScanConfig((), tmp_path).polar
    assert config.robot.box_m == (-1.2, 0.4, -0.5, 0.5)
