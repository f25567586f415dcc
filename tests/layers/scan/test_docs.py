"""The page about scans: its snippets run, its tables say what the code does."""

import re
from pathlib import Path

import numpy as np
import pytest

from bumpymap.core.settings import read_settings_file
from bumpymap.layers.scan_folder import SCAN_CLASS_NAMES, SCAN_COLOURS
from bumpymap.scan.config import SCAN_PRODUCTS, ScanConfig
from bumpymap.scan.pipeline import scan_frames

pytestmark = pytest.mark.slow

PAGE = Path(__file__).resolve().parents[3] / "docs" / "pages" / "scans.md"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture(name="place", scope="module")
def place_fixture(tmp_path_factory, scan):
    folder = tmp_path_factory.mktemp("docs")
    (folder / "drive").mkdir()
    np.column_stack([scan.points, scan.intensity]).astype("<f4").tofile(folder / "drive" / "NAME.bin")
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    scan_frames(ScanConfig((folder / "drive",), folder / "OUT", poses=folder / "poses.txt"))
    return folder


@pytest.mark.parametrize("number", range(len(blocks("python"))))
def test_snippet_runs(place, monkeypatch, number):
    monkeypatch.chdir(place)
    names = {}
    exec(compile(blocks("python")[number], f"scans.md, snippet {number}", "exec"), names)  # noqa: S102 (our own page)
    assert any(not name.startswith("__") for name in names)


def test_the_settings_of_the_page_are_settings(tmp_path):
    (text,) = blocks("toml")
    (tmp_path / "a.toml").write_text(text)
    config = ScanConfig(**read_settings_file(tmp_path / "a.toml", ScanConfig))
    assert config.polar == ScanConfig((), tmp_path).polar
    assert config.robot.box_m == (-1.2, 0.4, -0.5, 0.5)


def test_the_tables_say_what_the_code_writes():
    text = PAGE.read_text(encoding="utf-8")
    for name, colour in zip((*SCAN_CLASS_NAMES[:3], "obstacle", "not ground"), SCAN_COLOURS, strict=True):
        assert re.search(rf"\| {name} \| `#{bytes(colour).hex()}` \|", text), name
    assert ", ".join(f"`{product}`" for product in SCAN_PRODUCTS) in text
