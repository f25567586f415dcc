"""The page of a batch: nothing of a file runs in it, unknown ground is grey, 500 surveys fit."""

import base64
import hashlib
import io
import re

import numpy as np
import pytest
import rasterio
from page_outline import Outline
from PIL import Image
from rasterio.enums import Resampling
from rasterio.transform import from_origin

from bumpymap.core import NO_CLASS, BadInputError, Barred
from bumpymap.layers import SurveyRow
from bumpymap.layers.colours import CLASS_COLOURS
from bumpymap.views import SurveyView, read_thumbnail
from bumpymap.views.page.batch_page import index_page

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
    page = index_page(rows, {HOSTILE: SurveyView(b"png", has_report=True)}, ["summary.csv"], HOSTILE, HOSTILE)
    found = Outline(page)
    assert (len(found.elements["script"]), len(found.elements["img"])) == (1, 1)
    assert set(found.attributes) & {"onerror", "onclick", "onload"} == set()
    assert found.text.count(HOSTILE) == 7  # title, heading, note, name, message, reason, CRS
    assert "%3Cscript%3E" in next(link["href"] for link in found.elements["a"] if "report" in link["href"])
    page = index_page([done("caf\udce9")], {"caf\udce9": SurveyView(has_report=True)}, [], "n\udce9")
    assert 'href="caf%E9/report.html"' in page
    assert "caf\\xe9" in page
    page.encode()


def test_the_policy_lets_the_page_s_own_style_and_script_run_and_nothing_else():
    page = index_page([done("a")], {"a": SurveyView(b"png")}, ["summary.csv"], "night")
    outline = Outline(page)
    (policy,) = [text for text in outline.attributes["content"] if "default-src" in text]
    for tag in ("style", "script"):
        body = re.search(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)[1]
        digest = base64.b64encode(hashlib.sha256(body.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'; img-src data:;")
    assert "unsafe" not in policy
    assert not re.findall(r"https?:|//[a-z]|@import|url\(", page)
    assert "style" not in outline.attributes


def test_what_failed_comes_first_and_names_link_to_reports_that_exist():
    rows = [done("a"), SurveyRow("b", "not reached"), SurveyRow("c", "failed", "broken"), done("d e")]
    rows.append(SurveyRow("e", "already done"))
    found = Outline(index_page(rows, {"d e": SurveyView(has_report=True)}, ["summary.csv"], "night"))
    assert names_of(found) == ["c", "b", "a", "d e", "e"]
    assert [link["href"] for link in found.elements["a"]] == ["summary.csv", "d%20e/report.html"]
    assert "5 surveys: 3 done (1 of them earlier), 1 not reached, 1 failed; 2.57 ha mapped\n" in found.text
    assert "60% passable, 15.0% unknown, mostly too few points" in found.text
    assert "smooth 50.0%, fair 20.0%, rough 10.0%, very rough 5.0%, unknown 15.0%" in found.text


def test_a_page_of_500_surveys_is_small():
    rows = [done(f"survey_{number:03}", min_x=5e5 + number, message="x" * 100) for number in range(500)]
    views = {row.name: SurveyView(bytes(1_800), has_report=True) for row in rows}
    assert len(index_page(rows, views, ["summary.csv"], "night").encode()) < 2_000_000


def test_places_are_drawn_if_two_are_known():
    far = done("far", crs="EPSG:32632", min_x=5e5, min_y=5e6, max_x=5.001e5, max_y=5.0001e6)
    assert "<figure>" not in index_page([done("a")], {}, [], "night")
    assert "<figure>" not in index_page([done("a"), done("b", crs="nonsense"), done("c", crs=None)], {}, [], "night")
    page = index_page([done("a"), far, SurveyRow("x", "failed")], {}, [], "night")
    boxes = re.findall(r'<rect class="good" x="([\d.]+)" y="([\d.]+)"[^>]*><title>(\w+)<', page)
    place = {name: (float(x), float(y)) for x, y, name in boxes}
    assert place["a"][0] < place["far"][0]  # Texas is west of Europe, and south
    assert place["a"][1] > place["far"][1]
    assert "1 without a known place" in page


def pixels(folder, class_id, barred, heights=None, most=100_000):
    """Write rasters; return their thumbnail, (rows, cols, 3)."""
    heights = np.zeros(class_id.shape, np.float32) if heights is None else heights.astype(np.float32)
    (folder / "rasters").mkdir()
    for name, values in (("class.tif", class_id), ("barred.tif", barred), ("heightmap.tif", heights)):
        rows, cols = values.shape
        nodata = NO_CLASS if values.dtype == np.uint8 else np.nan
        how = {"driver": "GTiff", "dtype": values.dtype, "count": 1, "nodata": nodata, "height": rows, "width": cols}
        scale = 3 * class_id.shape[0] / rows
        with rasterio.open(folder / "rasters" / name, "w", transform=from_origin(0, 0, scale, scale), **how) as file:
            file.write(values, 1)
            file.build_overviews([2, 4], Resampling.mode if values.dtype == np.uint8 else Resampling.average)
    png = io.BytesIO(read_thumbnail(folder, most))
    return np.asarray(Image.open(png).convert("RGB")).astype(int)


def tiles(side, class_id=0):
    """Tiles of one class that can all be crossed."""
    return np.full((side, side), class_id, np.uint8), np.full((side, side), Barred.NO, np.uint8)


def test_unknown_ground_is_grey_even_among_known_tiles(tmp_path):
    """Three of four tiles unknown: an overview of class.tif has the class of the fourth."""
    class_id, barred = tiles(480)
    mostly = np.zeros((480, 480), bool)
    mostly[:240, :240] = True
    mostly[:240:2, :240:2] = False
    class_id[mostly], barred[mostly] = NO_CLASS, Barred.UNKNOWN
    class_id[240:, 240:] = barred[240:, 240:] = NO_CLASS
    found = pixels(tmp_path, class_id, barred)
    assert found.shape == (240, 240, 3)
    assert (np.ptp(found[:120, :120], axis=2) < 4).all()
    assert (found[:120, :120] < 200).all()
    assert (found[120:, 120:] > 250).all()
    assert np.abs(found[:120, 120:] - CLASS_COLOURS[0][:3]).max() < 12


@pytest.mark.parametrize("most", [100_000, 300])
def test_smooth_ground_that_is_not_passable_is_dark(tmp_path, most):
    """A steep but smooth slope: its class alone would look as if it could be driven."""
    class_id, barred = tiles(96)
    barred[:, 48:] = Barred.SLOPE
    dark = (pixels(tmp_path, class_id, barred, most=most) < 80).all(axis=2)
    np.testing.assert_array_equal(dark, np.broadcast_to(np.arange(dark.shape[1]) >= dark.shape[1] // 2, dark.shape))


@pytest.mark.parametrize("most", [100_000, 700])
def test_colours_of_rare_ground_are_not_mixed(tmp_path, most):
    """A little grey among light blue stays grey, however few colours a picture has."""
    class_id, barred = tiles(96, 1)
    class_id[48:54, 48:54], barred[48:54, 48:54] = NO_CLASS, Barred.UNKNOWN
    found = pixels(tmp_path, class_id, barred, np.random.default_rng(0).normal(0, 1, (96, 96)), most)
    spread = np.ptp(found.reshape(-1, 3), axis=1)
    assert 0.5 < (spread < 2).sum() / (6 * len(found) / 96) ** 2 < 2
    assert ((spread < 2) | (spread > 20)).all()


def test_relief_is_lit_from_the_north_west_and_a_picture_is_as_small_as_asked(tmp_path):
    ridge = np.broadcast_to(-np.abs(np.arange(96) - 48) * 2.0, (96, 96))
    found = pixels(tmp_path, *tiles(96), ridge).sum(axis=2)
    assert found[:, 10:40].mean() > found[:, 56:86].mean() + 50
    rng, noisy = np.random.default_rng(0), tmp_path / "noisy"
    noisy.mkdir()
    pixels(noisy, rng.integers(0, 4, (96, 96)).astype(np.uint8), tiles(96)[1], rng.normal(0, 5, (960, 960)))
    sizes = [len(read_thumbnail(noisy, most)) for most in (12_000, 1_800, 10)]
    assert 1_800 < sizes[0] <= 12_000
    assert 0 < sizes[1] <= 1_800
    assert sizes[2] == 0
    (noisy / "rasters/class.tif").write_bytes(b"nothing")
    with pytest.raises(BadInputError, match=r"cannot read .*class\.tif"):
        read_thumbnail(noisy, 10_000)
