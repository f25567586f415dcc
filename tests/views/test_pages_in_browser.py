"""report.html in a real browser: no error, no request, nothing that a screen reader trips over, usable by keyboard."""

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
import rasterio
from axe_playwright_python.sync_playwright import Axe
from page_outline import Outline, ReadPage
from pyproj import Transformer
from route_maps import copy_folder, list_anew, plant_photo

from bumpymap.layers import OFF_COLOURS, MapOffset, RideScale, SurveyRow
from bumpymap.views import index_page, write_report

pytestmark = pytest.mark.chromium
WIDE, PHONE, TABLET = (1440, 900), (390, 844), (820, 1180)


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


@pytest.mark.parametrize(
    ("size", "scheme"), [(WIDE, "light"), (PHONE, "light"), (TABLET, "dark")], ids=["wide", "phone", "dark tablet"]
)
@pytest.mark.parametrize("name", ["one", "odd", "change", "check"])
def test_no_error_no_request_axe_finds_nothing_and_prints_fit_their_sheet(visit, pages, name, size, scheme):
    """What is wider than 178 mm would shrink all of a print, the map and its scale too."""
    page = visit(pages[name], size, color_scheme=scheme)
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
    shown = [still.is_visible(what) for what in ("img.still", "table", ".legends", "canvas", ".layers")]
    assert shown == [True, True, True, False, False]


@pytest.mark.parametrize(("size", "most"), [(WIDE, 260), (PHONE, 350)], ids=["wide", "phone"])
def test_the_first_screen_is_title_sentence_map_and_legend(visit, pages, size, most):
    page = visit(pages["one"], size)
    box = page.locator(".legends").bounding_box()
    assert page.locator(".stage").bounding_box()["y"] <= most
    assert box["y"] + box["height"] <= size[1]
    assert page.locator(".stage :is(button, summary, input):visible").count() <= 3
    assert page.pdf(prefer_css_page_size=True).count(b"/Type /Page\n") <= 4


def test_wheel_and_double_click_zoom_at_once_and_the_page_scrolls_where_the_whole_map_is_seen(visit, pages):
    page, state = visit(pages["one"]), "[window.reportMaps[0].scale, window.scrollY]"
    start = page.evaluate(state)
    page.mouse.move(700, 500)
    page.mouse.wheel(0, -300)
    page.wait_for_timeout(100)
    closer = page.evaluate(state)
    assert (closer[0] > 1.2 * start[0], closer[1]) == (True, 0)
    page.mouse.dblclick(700, 500)
    assert page.evaluate(state)[0] == pytest.approx(2 * closer[0])
    page.click("button[value=all]")
    assert page.evaluate(state)[0] == pytest.approx(start[0])
    page.wait_for_timeout(450)
    page.mouse.move(700, 500)
    page.mouse.wheel(0, 300)
    page.wait_for_timeout(300)
    scale, down = page.evaluate(state)
    assert (scale == pytest.approx(start[0]), down > 0) == (True, True)


def test_layers_change_by_keyboard_with_their_legends(visit, pages):
    page = visit(pages["one"])
    pixels = "window.reportMaps[0].canvas.toDataURL().length + window.reportMaps[0].canvas.toDataURL().slice(-4000)"
    page.focus("summary")
    page.keyboard.press("Enter")
    page.focus("input[type=radio][value=c_r]")
    seen = set()
    for _ in range(7):
        chosen = page.evaluate("document.querySelector('input[type=radio]:checked').value")
        legends = page.evaluate("[...document.querySelectorAll('ul[data-of]:not([hidden])')].map(e => e.dataset.of)")
        assert legends == ([] if chosen == "none" else [chosen])
        seen.add((chosen, page.evaluate(pixels)))
        page.keyboard.press("ArrowDown")
    assert len({chosen for chosen, _ in seen}) == len({picture for _, picture in seen}) == 7


@pytest.fixture(scope="module")
def grey(site, tmp_path_factory):
    """The map with a photo that is grey throughout; every other column of its tiles is islands."""
    folder = plant_photo(copy_folder(site, tmp_path_factory.mktemp("grey") / "site"), 90)
    tiles = pq.read_table(folder / "tiles.parquet")
    of_free = np.where(tiles["col"].to_numpy() % 2, 1, 2 + np.arange(len(tiles)))
    zones = np.where(pc.is_null(tiles["barred"]), of_free, 0)
    at = tiles.schema.get_field_index("zone")
    tiles = tiles.set_column(at, tiles.schema.field(at), pa.array(zones, pa.int32(), mask=zones == 0))
    pq.write_table(tiles, folder / "tiles.parquet")
    record = json.loads((folder / "run.json").read_text())
    record["counts"]["zones"] |= {"pieces": 2, "islands": 1}
    list_anew(folder, counts=record["counts"])
    write_report(folder)
    return folder


PIXELS = """([places, key, without]) => { const map = window.reportMaps[0];
    document.querySelector(`input[type=radio][value=${key}]`).checked = true;
    for (const box of document.querySelectorAll('input[type=checkbox]')) {
      if (without.includes(box.value)) box.checked = false;
    }
    map.show();
    return places.map(([right, down]) => {
      [map.scale, map.middle, map.atAll] = [60, [right, down], false];
      map.draw();
      return [...map.context.getImageData(map.canvas.width / 2, map.canvas.height / 2, 1, 1).data].slice(0, 3);
    }); }"""
SWATCHES = """Object.fromEntries([...document.querySelectorAll('.legends li:has(.swatch)')].map((entry) => {
    const parts = [...entry.querySelectorAll('.swatch rect[fill^="#"]')];
    return [entry.textContent.trim(), parts.map((part) => part.getAttribute('fill'))]; }))"""


def test_ground_has_the_colours_of_its_legend_under_a_photo_of_one_grey(visit, grey):
    page, about = visit(grey / "report.html"), ReadPage(grey / "report.html")
    ground, barred, (c_r, _) = about.codes("ground"), about.codes("barred"), about.values("c_r")
    objects, swatches = about.objects(), page.evaluate(SWATCHES)
    islands = about.bytes_of(about.data["maps"][0]["islands"], about.data["maps"][0]) > 0
    free, driven = (barred == 0) & ~islands, ~np.isnan(c_r)
    legend = {name: [int(fills[0][at : at + 2], 16) for at in (1, 3, 5)] for name, fills in swatches.items()}

    def colours(chosen, key, *without, part=1):
        places = np.argwhere(chosen)[:20, ::-1] + 0.5
        assert len(places) > 1
        return np.array(page.evaluate(PIXELS, [(places * 3.0 / part).tolist(), key, ["objects", *without]]))

    def near(found, wanted):
        return np.abs(found - np.array(wanted)).max() <= 6

    scale = RideScale.of(json.loads((grey / "run.json").read_text()))
    stops = "[...document.querySelectorAll('#ride-ramp stop')].map((stop) => stop.getAttribute('stop-color'))"
    assert page.evaluate(stops)[1::2] == [fills[0] for name, fills in swatches.items() if name[0] in "0123"]
    dark = np.isin(objects, (1, 4))
    chosen = dark & np.repeat(np.repeat(ground < 4, 15, axis=0), 15, axis=1)
    found = page.evaluate(PIXELS, [((np.argwhere(chosen)[:20, ::-1] + 0.5) * 0.2).tolist(), "c_r", []])
    assert near(found, legend["obstacle, step"])
    island = [[*bytes.fromhex(fill[1:])] for fill in swatches["island, cut off"]]
    for code, name in enumerate(("0 smooth", "1 fair", "2 rough", "3 very rough")):
        (wanted,) = [colour for text, colour in legend.items() if text.startswith(name)]
        assert near(colours(free & (ground == code), "class"), wanted)
        assert near(colours(islands & (ground == code), "class"), island[code])
    assert near(colours(free & driven, "c_r"), scale.colours(c_r[free & driven][:20]))
    for key in ("c_r", "class", "slope", "p_fail", "cost"):
        assert near(colours((barred > 1) & (barred < 255) & (ground < 4), key), legend["closed"])
        assert near(colours((ground >= 16) & (ground < 255), key), legend["not known"])
    assert near(colours(ground == 255, "c_r"), [255, 255, 255])
    assert near(colours((barred > 1) & (ground == 3), "class", "barred"), legend[[*legend][3]])


def test_a_way_has_its_profile_which_marks_its_place_on_the_map_and_is_marked_from_it(visit, site, tmp_path):
    about = json.loads((site / "run.json").read_text())
    with rasterio.open(site / "rasters/class.tif") as file:
        west, north = file.bounds.left, file.bounds.top
    east = west + np.linspace(10.0, 100.0, 91)
    to_lonlat = Transformer.from_crs(about["crs"]["wkt"], "OGC:CRS84", always_xy=True)
    line = {"type": "LineString", "coordinates": [to_lonlat.transform(x, north - 40.0) for x in east[[0, -1]]]}
    feature = {"type": "Feature", "properties": {"name": "loop"}, "geometry": line}
    (tmp_path / "route.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    rows = [
        f"loop,{at},{x},{north - 40.0},{5 + at / 10},{0.1},{0.08},{0.15 if at else ''}" for at, x in enumerate(east)
    ]
    (tmp_path / "profile.csv").write_text("\n".join(["route,distance_m,x,y,z_m,c_r,c_r_low,c_r_high", *rows]))
    page = visit(write_report(site, tmp_path / "way.html", route=tmp_path))
    chart, slider = page.locator(".profile svg"), page.locator(".profile input")
    box = chart.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 20)
    assert page.evaluate("window.reportMaps[0].marked") == pytest.approx([west + 55.0, north - 40.0], abs=0.6)
    assert (slider.input_value(), chart.locator(".cursor").get_attribute("hidden")) == ("45", None)
    assert "45 m along the way · height 9.5 m · ride cost C_r 0.100 rad/m (80 % interval 0.080 to 0.150)" in (
        page.inner_text(".readout")
    )
    assert "nan" not in page.inner_html(".profile")  # the interval is not known at its first place
    slider.press("ArrowRight")
    assert page.evaluate("window.reportMaps[0].marked[0]") == pytest.approx(west + 56.0, abs=0.01)
    there = "(map) => [30 - map.middle[0], 40 - map.middle[1], map.width, map.height, map.scale]"
    there = page.evaluate(f"({there})(window.reportMaps[0])")
    view = page.locator("canvas").bounding_box()
    right, down = (there[2 + axis] / 2 + there[axis] * there[4] for axis in (0, 1))
    page.mouse.move(view["x"] + right, view["y"] + down)
    assert int(slider.input_value()) == pytest.approx(20, abs=1)
    page.mouse.move(view["x"] + right, view["y"] + down - 60)
    assert page.evaluate("window.reportMaps[0].marked") is None


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


def test_the_pointer_reads_what_the_grids_hold_and_unknown_ground_is_grey(visit, pages):
    page, about = visit(pages["one"]), ReadPage(pages["one"])
    ground, (c_r, _) = about.codes("ground"), about.values("c_r")
    row, col = first(ground == 2)
    text, _ = page.evaluate(POINT_AT, [row, col, "class"])
    assert "class 2 rough" in text
    assert f"ride cost C_r {c_r[row, col]:.3f} rad/m" in text
    for key in ("class", "c_r", "slope", "barred", "none"):
        _, colour = page.evaluate(POINT_AT, [*first((ground >= 16) & (ground < 255)), key])
        assert np.ptp(colour) <= 2, f"unknown ground has a colour in the layer {key}"


def test_the_pointer_reads_what_has_changed_and_what_is_not_compared_never_looks_unchanged(visit, pages):
    page, about = visit(pages["change"]), ReadPage(pages["change"])
    kinds, (heights, _), (rides, _) = about.codes("ground"), about.values("d_height"), about.values("d_c_r")
    row, col = first(kinds == 2)
    text, colour = page.evaluate(POINT_AT, [row, col, "changed"])
    assert text.startswith("rougher ·")
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
    page.click("summary")
    page.uncheck("input[value=stretches]")
    page.click("summary")
    assert page.evaluate(ON_SCREEN, worst)["pixel"] != found["pixel"]
    page.mouse.move(found["x"] + 1, found["y"])
    assert "measured" not in page.locator(".readout").inner_text()


def test_the_table_of_a_batch_is_sorted(visit, tmp_path):
    rows = [SurveyRow(name, "done", points=points) for name, points in (("a", 90), ("b", 1_000), ("d", 200))]
    page_of = index_page([*rows, SurveyRow("c", "failed")], {}, [], "night")
    (tmp_path / "index.html").write_text(page_of, encoding="utf-8")
    page = visit(tmp_path / "index.html")
    assert page.locator("button").count() == 9  # under its own policy
    page.locator("button").nth(2).click()
    found = Outline(page.content()).elements["th"]
    assert [cell["data-v"] for cell in found if cell.get("scope") == "row"] == ["a", "d", "b", "c"]
    assert [head.get("aria-sort") for head in found if head.get("scope") == "col"][2] == "ascending"
