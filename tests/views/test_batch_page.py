"""The page of a batch: nothing of a file runs in it, unknown ground is grey, 500 surveys fit."""

import base64
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from page_outline import Outline
from PIL import Image
from route_maps import copy_folder
from small_surveys import write_bomb

from bumpymap.layers import SurveyRow, map_facts
from bumpymap.views import SurveyView, read_thumbnail
from bumpymap.views.page.batch_page import index_page

PICTURE = "data:image/jpeg;base64,AA=="
HOSTILE = "<script>alert(1)</script>\"'&<img src=x onerror=alert(2)>"


def done(name, **other):
    known = {
        "points": 1_228_505, "density": 96.3, "area": 12_834.0, "seconds": 3.4, "share_smooth": 0.5, "share_fair": 0.2,
        "share_rough": 0.1, "share_very_rough": 0.05, "share_unknown": 0.15, "share_passable": 0.6,
        "unknown_reason": "too few points", "crs": "EPSG:32614", "min_x": 5e5, "min_y": 4e6, "max_x": 5.01e5,
        "max_y": 4.001e6,
    }  # fmt: skip
    return SurveyRow(name, "done", **(known | other))


def names_of(page):
    """The names of the surveys in the order of the rows."""
    return [cell["data-v"] for cell in page.elements["th"] if cell.get("scope") == "row"]


def test_text_of_files_is_text():
    rows = [SurveyRow(HOSTILE, "failed", f"{HOSTILE} is broken"), done("b", crs=HOSTILE, unknown_reason=HOSTILE)]
    page = index_page(rows, {HOSTILE: SurveyView(PICTURE, has_report=True)}, ["summary.csv"], HOSTILE, HOSTILE)
    found = Outline(page)
    assert (len(found.elements["script"]), len(found.elements["img"])) == (1, 1)
    assert set(found.attributes) & {"onerror", "onclick", "onload"} == set()
    assert found.text.count(HOSTILE) == 7  # title, heading, note, name, message, reason, CRS
    assert "%3Cscript%3E" in next(link["href"] for link in found.elements["a"] if "report" in link["href"])
    page = index_page([done("caf\udce9")], {"caf\udce9": SurveyView(has_report=True)}, [], "n\udce9")
    assert 'href="caf%E9/report.html"' in page
    assert "caf\\xe9" in page
    page.encode()


def test_what_failed_comes_first_and_names_link_to_reports_that_exist():
    rows = [done("a"), SurveyRow("b", "not reached"), SurveyRow("c", "failed", "broken"), done("d e")]
    rows.append(SurveyRow("e", "already done"))
    found = Outline(index_page(rows, {"d e": SurveyView(has_report=True)}, ["summary.csv"], "night"))
    assert names_of(found) == ["c", "b", "a", "d e", "e"]
    assert [link["href"] for link in found.elements["a"]] == ["summary.csv", "d%20e/report.html"]
    assert "5 surveys: 3 done (1 of them earlier), 1 not reached, 1 failed; 2.57 ha mapped\n" in found.text
    assert "60%" in found.text
    assert "15.0% unknown, mostly too few points" in found.text
    assert "smooth 50.0%, fair 20.0%, rough 10.0%, very rough 5.0%, unknown 15.0%" in found.text


def test_a_page_of_500_surveys_is_small():
    rows = [done(f"survey_{number:03}", min_x=5e5 + number, message="x" * 100) for number in range(500)]
    views = {row.name: SurveyView("A" * 2_400, has_report=True) for row in rows}
    assert len(index_page(rows, views, ["summary.csv"], "night").encode()) < 2_000_000


def test_surveys_are_sorted_by_what_can_be_crossed():
    rows = [done("a", share_passable=0.2), done("b", share_passable=0.9), done("c", share_passable=0.5)]
    page = index_page(rows, {}, [], "night")
    assert re.findall(r'class="name" data-v="(\w)"', page) == ["b", "c", "a"]


def test_the_picture_is_that_of_the_map_as_small_as_asked(site, tmp_path):
    with Image.open(site / "rasters/thumbnail.jpg") as whole:
        wanted = np.asarray(whole.resize((80, 60), Image.Resampling.BOX), float)
    for most, width in ((40_000, 240), (2_400, 60)):
        text = read_thumbnail(site, most)
        assert len(text) <= most
        with Image.open(io.BytesIO(base64.b64decode(text.removeprefix("data:image/jpeg;base64,")))) as picture:
            assert picture.size == (width, width * 3 // 4)
            found = np.asarray(picture.resize((80, 60), Image.Resampling.BOX), float)
        if width == 240:
            assert np.abs(found - wanted).mean() < 12
    assert read_thumbnail(site, 10) == ""


@pytest.mark.parametrize("damage", [write_bomb, Path.mkdir, lambda path: path.write_bytes(b"\xff\xd8\xff"), None])
def test_a_picture_that_cannot_be_read_costs_a_map_its_picture_alone(site, tmp_path, caplog, damage):
    path = copy_folder(site, tmp_path / "map") / "rasters/thumbnail.jpg"
    path.unlink()
    if damage:
        damage(path)
    assert read_thumbnail(tmp_path / "map", 10_000) == ""
    assert "rasters/thumbnail.jpg is not shown: " in caplog.text


def test_a_map_without_tiles_has_a_row_without_shares(site, tmp_path):
    counts = json.loads((site / "run.json").read_text())["counts"]
    none = dict.fromkeys(("tiles", "passable", "unknown"), 0) | {"by_reason": {}}
    none["by_class"] = dict.fromkeys(counts["by_class"], 0)
    facts = map_facts(copy_folder(site, tmp_path / "map", counts=counts | none))
    wanted = {"tiles": 0, "area": 0.0} | dict.fromkeys(("density", "share_smooth", "share_passable", "share_unknown"))
    assert {name: facts[name] for name in wanted} == wanted
    assert "passable," not in index_page([SurveyRow("none", "done", **facts)], {}, [], "night")
