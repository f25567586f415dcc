"""Surveys of a batch that are written in sheets: settings from everywhere, and the same summary and page."""

import csv
import re

import pytest
from click.testing import CliRunner
from small_surveys import write_survey

from bumpymap.cli import main
from bumpymap.layers.sheet_paths import sheet_folders

pytestmark = pytest.mark.slow


def batch(*words):
    return CliRunner().invoke(main, ["batch", *map(str, words)])


def rows(folder):
    with (folder / "summary.csv").open(encoding="utf-8", newline="") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def test_the_summary_and_the_page_show_sheets_like_one_map(tmp_path):
    """One survey in sheets by its row in the table, the other not."""
    for name in ("wide", "small"):
        write_survey(tmp_path / f"{name}.laz", side=60.0, points=60_000)
    (tmp_path / "night.csv").write_text("survey,sheets\nwide.laz,0.048\nsmall.laz,\n")
    first = batch(tmp_path / "night.csv", "--out", tmp_path / "out")
    assert first.exit_code == 0, first.output
    wide, small = tmp_path / "out" / "wide", tmp_path / "out" / "small"
    assert len(sheet_folders(wide)) > 1
    assert sheet_folders(small) == [small]

    found = rows(tmp_path / "out")
    of_its_own = {"name", "seconds", "survey"}
    assert {key: value for key, value in found["wide"].items() if key not in of_its_own} == {
        key: value for key, value in found["small"].items() if key not in of_its_own
    }
    page = (tmp_path / "out" / "index.html").read_text()
    assert {"wide/report.html", "small/report.html"} <= set(re.findall(r'href="([^"]+)"', page))
    assert page.count("data:image/png") == 2

    again = batch(tmp_path / "night.csv", "--out", tmp_path / "out")
    assert again.exit_code == 0, again.output
    assert {row["status"] for row in rows(tmp_path / "out").values()} == {"already done"}
