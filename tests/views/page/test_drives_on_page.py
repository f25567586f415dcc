"""check.html: real drives over the map they were checked against."""

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from check_records import made_up_check, make_check, stretches_at
from page_outline import Outline
from route_maps import copy_folder

from bumpymap.check.pipeline import write_check
from bumpymap.core import CLASS_NAMES
from bumpymap.layers import open_map
from bumpymap.layers.check_vectors import MapOffset
from bumpymap.views import check_headline
from bumpymap.views.page.charts import along_chart, drive_chart


def on_site(result, site):
    """The same stretches within a map."""
    ground = open_map(site)
    bounds = ground.grid.window_bounds(ground.window)
    part = np.linspace(0.1, 0.9, len(result.stretches.drive))
    easting = bounds.west + part * (bounds.east - bounds.west)
    northing = bounds.south + part * (bounds.north - bounds.south)
    return replace(result, stretches=replace(result.stretches, easting=easting, northing=northing)), ground


@pytest.fixture(scope="module")
def checked(site, tmp_path_factory):
    """A check of the map ``site``: its folder and its findings."""
    bad = "<img src=x onerror=alert(1)>\"'</script><script>alert(2)</script>"
    result, ground = on_site(made_up_check(50, noise=0.35, unknown=[4], drives=2, warnings=[bad]), site)
    result = replace(result, drives=(replace(result.drives[0], name=bad), result.drives[1]))
    out = tmp_path_factory.mktemp("checked") / "out"
    write_check(result, out, ground=ground)
    return out, result


def test_every_stretch_is_on_the_map(checked, read_page):
    (about,) = read_page(checked[0] / "check.html").data["maps"]
    stretches, offset = checked[1].stretches, MapOffset.of(checked[1].stretches)
    found = about["stretches"]
    assert [spot["east"] for spot in found] == pytest.approx(stretches.easting, abs=0.01)
    assert [spot["kind"] for spot in found] == offset.kind.tolist()
    assert [spot["off"] for spot in found] == offset.is_off.tolist()
    assert f"measured {stretches.measured[7]:.3f} rad/m, the map says {stretches.c_r[7]:.3f}" in found[7]["text"]
    assert found[4]["text"].endswith("rad/m")


def test_without_a_check_nothing_of_drives_is_on_the_page(site, read_page):
    page = read_page(site / "report.html")
    assert "Against real drives" not in page.text
    assert "Real drives" not in page.text
    assert page.data["maps"][0]["stretches"] == []


def test_the_page_holds_map_figures_and_drives(checked, read_page):
    out, result = checked
    page = read_page(out / "check.html")
    outline = Outline(page.text)
    (about,) = page.data["maps"]
    assert len(about["stretches"]) == 50
    assert check_headline(result) in unescape(page.text)
    rows = outline.tables["Map against drives"]
    classes = [f"{code} {name}" for code, name in enumerate(CLASS_NAMES) if code in result.by_class]
    assert [row[0] for row in rows[1:]] == ["all", *classes]
    assert sum(int(row[1]) for row in rows[2:]) == int(rows[1][1]) == 49
    (worst,) = (table for title, table in outline.tables.items() if title.startswith("Stretches that are off"))
    measured, c_r = (np.array([float(row[at].split()[0]) for row in worst[1:]]) for at in (3, 4))
    assert 0 < len(worst) - 1 <= 10
    assert np.array([float(row[6]) for row in worst[1:]]) == pytest.approx(c_r / measured, rel=0.03)
    assert "onerror=alert(1)&gt;" in page.text
    assert "<img src=x" not in page.text
    assert page.text.count("<circle") == 49 + 50


def test_the_page_of_drives_without_a_map_has_no_map(tmp_path, read_page):
    result = made_up_check(8, ground=False, drives=2)
    drives = (replace(result.drives[0], warnings=("drive 1: no standstill", "too fast")), result.drives[1])
    write_check(replace(result, drives=drives), tmp_path)
    page = read_page(tmp_path / "check.html")
    assert page.data["maps"] == []
    assert "Map against drives" not in Outline(page.text).tables
    assert "Spearman" not in page.text
    assert "<h1>Drives measured: drive 1, drive 2</h1>" in page.text
    assert "<li>drive 1: no standstill</li>\n<li>drive 1: too fast</li>" in page.text


def test_layers_that_cannot_be_drawn_leave_a_page_without_a_map(site, checked, tmp_path, read_page):
    later = copy_folder(site, tmp_path / "later", name="later")
    result, ground = on_site(made_up_check(50), later)
    (later / "tiles.parquet").unlink()
    write_check(result, tmp_path / "out", ground=ground)
    assert read_page(tmp_path / "out" / "check.html").data["maps"] == []


MARK, TICK = r'<circle cx="(.*?)" cy="(.*?)"', r'<text x="([\d.]+)" y="\d+" text-anchor="middle">([\d.]+)</text>'


def test_a_mark_lies_at_what_map_and_drive_say():
    result = make_check(stretches_at(np.zeros((2, 2)), [0.1, 0.4], np.array([1.0, 3.0])))
    chart, along = ("".join(draw(result).elements) for draw in (drive_chart, along_chart))
    (x, y), (right, top) = np.array(re.findall(MARK, chart), float)
    ticks = np.array(re.findall(TICK, chart), float)
    scale = np.polyfit(np.log(ticks[:, 1]), ticks[:, 0], 1)
    assert [x, right] == pytest.approx(np.polyval(scale, np.log([0.1, 0.4])), abs=0.2)
    assert (y - top) / (right - x) == pytest.approx(np.log(12) / np.log(4) * 380 / 484, rel=0.01)
    first, second = np.array(re.findall(MARK, along), float)
    zero = float(re.search(r'y="([\d.]+)" text-anchor="end">0</text>', along)[1]) - 4
    assert (zero - second[1]) / (zero - first[1]) == pytest.approx(12.0, rel=0.01)
    assert second[0] - first[0] == pytest.approx((1120 - 64 - 12) / 2, abs=0.2)


_ON_SCREEN = """at => {
  const map = window.reportMaps[0], spot = map.about.stretches[at], box = map.canvas.getBoundingClientRect();
  const right = map.width / 2 + (spot.east - map.about.west - map.middle[0]) * map.scale;
  const down = map.height / 2 + (map.about.north - spot.north - map.middle[1]) * map.scale;
  const pixel = [...map.context.getImageData(right * map.dense, down * map.dense, 1, 1).data].slice(0, 3);
  return { x: box.left + right, y: box.top + down, pixel };
}"""


@pytest.mark.chromium
@pytest.mark.parametrize("width", [1400, 400])
def test_in_a_browser_marks_have_their_colour_and_words_and_axe_finds_nothing(browser, checked, width):
    from axe_playwright_python.sync_playwright import Axe

    from bumpymap.layers.colours import OFF_COLOURS

    page = browser.new_page(viewport={"width": width, "height": 900})
    complaints, requests = [], []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto((checked[0] / "check.html").as_uri())
    page.wait_for_selector("html[data-ready]")
    page.locator(".stage").first.scroll_into_view_if_needed()
    offset = MapOffset.of(checked[1].stretches)
    worst = int(np.nanargmax(offset.beyond))
    found = page.evaluate(_ON_SCREEN, worst)
    assert np.abs(np.array(found["pixel"]) - OFF_COLOURS[int(offset.kind[worst])][:3]).max() <= 2
    page.mouse.move(found["x"], found["y"])
    assert f"measured {checked[1].stretches.measured[worst]:.3f} rad/m" in page.locator(".readout").inner_text()
    page.uncheck("input[value=stretches]")
    hidden = page.evaluate(_ON_SCREEN, worst)
    assert hidden["pixel"] != found["pixel"]
    page.mouse.move(found["x"] + 1, found["y"])
    assert "measured" not in page.locator(".readout").inner_text()
    page.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true; })")
    result = Axe().run(page)
    assert result.violations_count == 0, result.generate_report()
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert [text for text in complaints if "getImageData" not in text] == []  # which this test itself calls
    assert [url for url in requests if not url.startswith(("file:", "data:"))] == []
    page.close()
