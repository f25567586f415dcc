"""report.html in a real browser: no error, no request, nothing that a screen reader trips over, usable by keyboard."""

import shutil

import numpy as np
import pytest
import rasterio
from axe_playwright_python.sync_playwright import Axe
from page_outline import Outline
from route_maps import change_bars, copy_folder

from bumpymap.core import Barred
from bumpymap.layers import BARRED_COLOURS, SurveyRow
from bumpymap.layers.check_files import MapOffset
from bumpymap.layers.colours import OFF_COLOURS
from bumpymap.views import write_report
from bumpymap.views.page.batch_page import index_page

pytestmark = pytest.mark.chromium
WIDE, PHONE = (1400, 900), (400, 800)


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        # in a container Chromium cannot make a sandbox of its own
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def visit(browser):
    """Return a function that opens a page and gives it with what it complained about and asked for."""
    contexts = []

    def open_page(path, size=WIDE, **options):
        context = browser.new_context(viewport={"width": size[0], "height": size[1]}, **options)
        contexts.append(context)
        page = context.new_page()
        page.complaints, page.requests = [], []
        page.on("console", lambda message: page.complaints.append(message.text))
        page.on("pageerror", lambda error: page.complaints.append(str(error)))
        page.on("request", lambda request: request.url.startswith("data:") or page.requests.append(request.url))
        page.goto(path.as_uri())
        if options.get("java_script_enabled", True) and path.name != "index.html":
            page.wait_for_selector("html[data-ready]")
        return page

    yield open_page
    for context in contexts:
        context.close()


@pytest.fixture(scope="module")
def pages(site, comparison, checked, tmp_path_factory):
    """The page of a map, of one whose names are markup, of what has changed, and of a check."""
    folder = tmp_path_factory.mktemp("pages")
    bad = "<img src=x onerror=alert(1)>\"'</script><script>alert(2)</script>"
    odd = copy_folder(
        site, folder / "odd", survey={"name": bad, "checksum": bad, "dates": []}, inputs=[{"path": bad, "format": bad}]
    )
    found = {"one": site / "report.html", "odd": write_report(odd), "change": comparison / "report.html"}
    return found | {"check": checked[0] / "check.html"}


@pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
@pytest.mark.parametrize("name", ["one", "odd", "change", "check"])
def test_no_error_no_request_axe_finds_nothing_and_prints_fit_their_sheet(visit, pages, name, size):
    """What is wider than 178 mm would shrink all of a print, the map and its scale too."""
    page = visit(pages[name], size)
    page.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true; })")
    found = Axe().run(page)
    assert found.violations_count == 0, found.generate_report()
    assert page.complaints == []
    assert page.requests == [pages[name].as_uri()]
    assert page.evaluate("document.documentElement.scrollWidth") == size[0]
    page.set_viewport_size({"width": 673, "height": 900})
    page.emulate_media(media="print")
    ends = "[...document.querySelectorAll('body, table, .stage')].map(part => part.getBoundingClientRect().right)"
    assert max(page.evaluate(ends)) <= 673.5


def test_the_policy_of_the_page_stops_requests(visit, pages):
    """That no request is seen means something: one that is tried is refused, and complained about."""
    page = visit(pages["one"])
    assert page.evaluate("fetch('https://example.invalid/').then(() => 'sent', () => 'refused')") == "refused"
    assert any("Content Security Policy" in text for text in page.complaints)
    assert page.requests == [pages["one"].as_uri()]


def test_the_map_goes_by_keyboard_and_stands_without_scripts(visit, pages):
    page = visit(pages["one"])
    for _ in range(20):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.tagName") == "CANVAS":
            break
    assert page.evaluate("document.activeElement.tagName") == "CANVAS"

    def view(*keys):
        for key in keys:
            page.keyboard.press(key)
        return page.evaluate("(() => { const map = window.reportMaps[0]; return [map.scale, ...map.middle]; })()")

    start, closer = view(), view("+")
    assert closer[0] > start[0]
    assert (np.array(view("ArrowRight", "ArrowDown"))[1:] > closer[1:]).all()
    assert "class" in page.inner_text(".readout") or "not known" in page.inner_text(".readout")
    assert view("-")[0] == pytest.approx(start[0])
    assert view("0") == pytest.approx(start)
    still = visit(pages["one"], java_script_enabled=False)
    shown = [still.is_visible(what) for what in ("img.still", "table", "canvas", ".controls")]
    assert shown == [True, True, False, False]


def test_layers_change_by_keyboard_with_their_legends(visit, pages):
    page = visit(pages["one"])
    pixels = "window.reportMaps[0].canvas.toDataURL().length + window.reportMaps[0].canvas.toDataURL().slice(-4000)"
    page.focus("input[type=radio][value=class]")
    seen = set()
    for _ in range(7):
        chosen = page.evaluate("document.querySelector('input[type=radio]:checked').value")
        legends = page.evaluate(
            "[...document.querySelectorAll('.legend[data-of]:not([hidden])')].map(e => e.dataset.of)"
        )
        assert legends == ([] if chosen == "none" else [chosen])
        seen.add((chosen, page.evaluate(pixels)))
        page.keyboard.press("ArrowDown")
    assert len({chosen for chosen, _ in seen}) == len({picture for _, picture in seen}) == 7


def test_what_cannot_be_crossed_is_hatched_unless_switched_off_and_dark_where_tiles_are_too_small(
    visit, pages, read_page
):
    """In every colouring, also where smooth ground is blue."""
    about = read_page(pages["one"])
    ground, barred = about.codes("ground"), about.codes("barred")
    closed, free = (
        np.argwhere((ground < 2) & chosen).tolist() for chosen in ((barred > 1) & (barred < 255), barred == 0)
    )
    assert len(closed) > 20 < len(free)
    look = """([places, keys]) => { const map = window.reportMaps[0];
        const side = map.about.metres * map.scale * map.dense, margin = Math.min(2, side / 4);
        return keys.map((key) => {
          document.querySelector(`input[type=radio][value=${key}]`).checked = true;
          map.draw();
          return places.map(([row, col]) => {
            const left = (col * map.about.metres - map.middle[0]) * map.scale * map.dense + map.canvas.width / 2;
            const top = (row * map.about.metres - map.middle[1]) * map.scale * map.dense + map.canvas.height / 2;
            const size = Math.max(1, side - 2 * margin);
            return [...map.context.getImageData(left + margin, top + margin, size, size).data];
          });
        }); }"""
    page, far = visit(pages["one"]), visit(pages["one"], PHONE)
    for key in ("objects", "relief", "grid"):
        page.uncheck(f"input[value={key}]")
        far.uncheck(f"input[value={key}]")
    far.evaluate("window.reportMaps[0].zoom(0.4)")
    assert far.evaluate("window.reportMaps[0].scale * window.reportMaps[0].about.metres") < 6
    assert max(np.reshape(one, (-1, 4))[:, :3].max() for one in far.evaluate(look, [closed, ["class"]])[0]) < 140
    assert min(np.reshape(one, (-1, 4))[:, :3].max() for one in far.evaluate(look, [free, ["class"]])[0]) > 160
    keys = ["class", "c_r", "p_fail", "slope", "cost", "barred", "none"]

    def dark():
        found = page.evaluate(look, [closed[:1], keys])
        return [(np.reshape(one, (-1, 4))[:, :3].max(axis=1) < 70).mean() for (one,) in found]

    lines = dark()
    page.uncheck("input[value=barred][type=checkbox]")
    assert all(here > there + 0.04 for here, there in zip(lines, dark(), strict=True))


POINT_AT = """([row, col, key]) => { const map = window.reportMaps[0];
    document.querySelector(`input[value=${key}]`).click();
    for (const box of document.querySelectorAll('input[type=checkbox]')) box.checked = false;
    map.draw();
    const at = [(col + 0.5) * map.about.metres, (row + 0.5) * map.about.metres]
      .map((metres, i) => (metres - map.middle[i]) * map.scale + [map.width, map.height][i] / 2);
    map.read(at);
    const pixel = map.context.getImageData(Math.round(at[0] * map.dense), Math.round(at[1] * map.dense), 1, 1).data;
    return [map.readout.textContent, [...pixel.slice(0, 3)]]; }"""


def first(chosen):
    """Row and column of the first pixel that is chosen."""
    return [int(place[0]) for place in np.nonzero(chosen)]


def test_the_pointer_reads_what_the_grids_hold_and_unknown_ground_is_grey(visit, pages, read_page):
    page, about = visit(pages["one"]), read_page(pages["one"])
    ground, (c_r, _) = about.codes("ground"), about.values("c_r")
    row, col = first(ground == 2)
    text, _ = page.evaluate(POINT_AT, [row, col, "class"])
    assert "class 2 rough" in text
    assert f"ride cost C_r {c_r[row, col]:.3f} rad/m" in text
    for key in ("class", "c_r", "slope", "barred", "none"):
        _, colour = page.evaluate(POINT_AT, [*first((ground >= 16) & (ground < 255)), key])
        assert np.ptp(colour) <= 2, f"unknown ground has a colour in the layer {key}"


def test_ground_of_which_too_little_was_seen_shows_its_reason_and_no_class(visit, site, tmp_path, read_page):
    path = write_report(change_bars(copy_folder(site, tmp_path / "thin"), 0, "too little seen"))
    page, place = visit(path), first(read_page(path).codes("barred") == Barred.LITTLE_SEEN)
    text, colour = page.evaluate(POINT_AT, [*place, "class"])
    assert "not known whether the vehicle can cross it: too little seen" in text
    assert np.ptp(colour) <= 2
    _, colour = page.evaluate(POINT_AT, [*place, "barred"])
    assert np.abs(np.subtract(colour, BARRED_COLOURS[Barred.LITTLE_SEEN][:3])).max() <= 2


def test_the_pointer_reads_the_ride_by_heading_as_words_and_as_a_rose(visit, pages, site, read_page, tmp_path):
    folder = copy_folder(site, tmp_path / "headings")
    assert visit(pages["one"]).locator(".rose").count() == 0
    with rasterio.open(folder / "rasters/class.tif") as file:
        about = file.profile | {"driver": "GTiff", "dtype": "float32", "count": 8, "nodata": np.nan}
    with rasterio.open(folder / "rasters/roughness.tif") as file:
        c_r = file.read(1)
    with rasterio.open(folder / "rasters/headings.tif", "w", **about) as file:
        file.write(c_r * np.array([1.5, 1, 1, 1, 0.5, 1, 1, 1], np.float32)[:, None, None])
    page = visit(write_report(folder))
    row, col = first(read_page(pages["one"]).codes("ground") == 2)
    text, _ = page.evaluate(POINT_AT, [row, col, "class"])
    assert f"calmest along E-W ({0.5 * c_r[row, col]:.3f}), roughest along N-S ({1.5 * c_r[row, col]:.3f})" in text
    assert page.locator(".rose polygon").get_attribute("points").startswith("52.0,4.0 ")  # as far as it goes, north
    assert page.locator(".rose").is_visible()
    page.evaluate("window.reportMaps[0].read([-9, -9])")
    assert not page.locator(".rose").is_visible()


def test_the_pointer_reads_what_has_changed_and_what_is_not_compared_never_looks_unchanged(visit, pages, read_page):
    page, about = visit(pages["change"]), read_page(pages["change"])
    kinds, (heights, _), (rides, _) = about.codes("ground"), about.values("d_height"), about.values("d_c_r")
    row, col = first(kinds == 2)
    text, colour = page.evaluate(POINT_AT, [row, col, "changed"])
    assert "· rougher ·" in text
    assert f"height after minus before {heights[row, col]:.2f} m" in text
    assert f"ride cost C_r after minus before +{rides[row, col]:.3f} rad/m" in text
    assert colour == about.data["codes"]["classColours"][2][:3]
    calm = page.evaluate(POINT_AT, [*first((kinds == 0) & np.isfinite(rides)), "changed"])
    assert calm[1] == about.data["codes"]["classColours"][0][:3]
    left_out, no_ride = first(kinds == 16), first((kinds == 0) & np.isnan(rides))
    for place, key in ((left_out, "changed"), (left_out, "d_height"), (left_out, "d_c_r"), (no_ride, "d_c_r")):
        text, colour = page.evaluate(POINT_AT, [*place, key])
        assert np.ptp(colour) <= 2, key  # grey
        assert max(colour) <= 180, key  # darker than white, which means no difference
        if place == left_out:
            assert "not compared: may have changed or not" in text


ON_SCREEN = """at => {
  const map = window.reportMaps[0], spot = map.about.stretches[at], box = map.canvas.getBoundingClientRect();
  const right = map.width / 2 + (spot.east - map.about.west - map.middle[0]) * map.scale;
  const down = map.height / 2 + (map.about.north - spot.north - map.middle[1]) * map.scale;
  const pixel = [...map.context.getImageData(right * map.dense, down * map.dense, 1, 1).data].slice(0, 3);
  return { x: box.left + right, y: box.top + down, pixel };
}"""


@pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
def test_stretches_have_their_colour_and_words(visit, pages, checked, size):
    page = visit(pages["check"], size)
    page.locator(".stage").first.scroll_into_view_if_needed()
    stretches, offset = checked[1].stretches, MapOffset.of(checked[1].stretches)
    worst = int(np.nanargmax(offset.beyond))
    found = page.evaluate(ON_SCREEN, worst)
    assert np.abs(np.array(found["pixel"]) - OFF_COLOURS[int(offset.kind[worst])][:3]).max() <= 2
    page.mouse.move(found["x"], found["y"])
    assert f"measured {stretches.measured[worst]:.3f} rad/m" in page.locator(".readout").inner_text()
    page.uncheck("input[value=stretches]")
    assert page.evaluate(ON_SCREEN, worst)["pixel"] != found["pixel"]
    page.mouse.move(found["x"] + 1, found["y"])
    assert "measured" not in page.locator(".readout").inner_text()


def test_the_table_of_a_batch_is_sorted(visit, tmp_path):
    rows = [SurveyRow(name, "done", points=points) for name, points in (("a", 90), ("b", 1_000), ("d", 200))]
    page_of = index_page([*rows, SurveyRow("c", "failed")], {}, [], "night")
    (tmp_path / "index.html").write_text(page_of, encoding="utf-8")
    page = visit(tmp_path / "index.html")
    assert page.locator("button").count() == 8  # under its own policy
    page.locator("button").nth(2).click()
    found = Outline(page.content()).elements["th"]
    assert [cell["data-v"] for cell in found if cell.get("scope") == "row"] == ["a", "d", "b", "c"]
    assert [head.get("aria-sort") for head in found if head.get("scope") == "col"][2] == "ascending"
