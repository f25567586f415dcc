"""Pages of a map, a comparison, a check and a batch: what their records say; nobody is asked, no name trusted."""

import base64
import io
import json
import re
import shutil
from base64 import b64decode
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from check_records import made_up_check, on_site
from cost_maps import COLS, ROWS, make_field, survey
from page_outline import Outline, ReadPage, require_no_requests
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from pyproj import Transformer
from route_maps import VEHICLE, change_bars, copy_folder, list_anew, plant_photo, write_folder
from small_surveys import band, run, write_bomb, write_broken

import bumpymap
from bumpymap.check.pipeline import write_check
from bumpymap.core import NO_CLASS, BadInputError, OutputError, PageSettings, UsageError
from bumpymap.core.types import CHANGE_KINDS, CLASS_NAMES, OBSTACLE, Georeference
from bumpymap.layers import MapOffset, SurveyRow, map_facts
from bumpymap.views import SurveyView, index_page, page_header, read_thumbnail, write_report
from bumpymap.views.light import levelled
from bumpymap.views.page import change_page
from bumpymap.views.page.change_page import NOT_COMPARED, write_change_report
from bumpymap.views.page.tiles import NO_POINTS, UNKNOWN_FROM
from bumpymap.views.words import check_headline, share


def counted(table):
    """The counts of a table by the names of its rows."""
    return {row[0]: row[3] for row in table[1:]}


def in_words(counts):
    return {name: f"{count:,}" for name, count in counts.items()}


def test_the_page_asks_nobody_and_its_tables_equal_the_counts_of_the_run(site):
    page = ReadPage(site / "report.html")
    require_no_requests(page.text)
    assert len(page.text.encode()) < 2_000_000
    counts, tables = json.loads((site / "run.json").read_text())["counts"], Outline(page.text).tables
    classes = {f"{code} {name}": counts["by_class"][name] for code, name in enumerate(CLASS_NAMES)}
    classes |= {"not known": counts["unknown"], "all": counts["tiles"]}
    assert counted(tables["Classes"]) == in_words(classes)
    assert counted(tables["What can be crossed"]) == in_words(counts["barred"] | {"passable": counts["passable"]})
    assert counted(tables["Why ground is not known"]) == in_words(counts["by_reason"])


def test_values_of_the_page_are_those_of_the_rasters_within_its_rounding(site):
    page = ReadPage(site / "report.html")
    classes, ground = band(site / "rasters/class.tif"), page.codes("ground")
    known = classes != NO_CLASS
    assert known.any()
    assert (ground[known] == classes[known]).all()
    assert (ground[~known] >= UNKNOWN_FROM).all()
    assert (page.codes("barred") == band(site / "rasters/barred.tif")).all()
    bands = {name: band(site / "rasters/roughness.tif", name) for name in ("c_r", "p_fail", "slope")}
    bands["cost"] = band(site / "cost.tif")
    for key, values in bands.items():
        shown, grid = page.values(key)
        wanted = np.where(known, values, np.nan)
        assert (np.isnan(shown) == np.isnan(wanted)).all(), key
        if grid["scale"] == "log":
            shown, wanted = np.log(shown), np.log(np.maximum(wanted, 1e-4))
        assert np.nanmax(np.abs(shown - wanted)) <= grid["step"] / 2 + 1e-6, key
    shown, grid = page.values("height")
    blocks = band(site / "rasters/heightmap.tif").reshape(30, 15, 40, 15).astype(float)
    count = np.isfinite(blocks).sum(axis=(1, 3))
    assert (np.isnan(shown) == (count == 0)).all()
    mean = np.nansum(blocks, axis=(1, 3)) / np.maximum(count, 1)
    assert np.abs(shown - mean)[count > 0].max() <= grid["step"] / 2 + 1e-3
    found = page.objects()
    assert np.array_equal(found, band(site / "rasters/obstacle.tif"))
    assert (found == OBSTACLE).any()


@pytest.mark.parametrize(("limit", "most", "step"), [("_SIDE", 20, 2), ("_TILES", 25, 7)])
def test_the_worst_tile_decides_a_pixel_of_several(site, tmp_path, monkeypatch, limit, most, step):
    import bumpymap.views.page.site as module

    one = ReadPage(site / "report.html")
    monkeypatch.setattr(module, limit, most)
    many = ReadPage(write_report(site, tmp_path / "coarse.html"))
    assert many.data["maps"][0]["metres"] == 3 * step
    assert f"One pixel of the map is {3 * step} m, {step} x {step} tiles of 3 m. The worst tile decides" in many.text
    grounds, bars = ([page.codes(name) for page in (one, many)] for name in ("ground", "barred"))
    standing, seen = one.objects().reshape(30, 15, 40, 15) == OBSTACLE, many.objects() == OBSTACLE
    rides, costs = ([page.values(key)[0] for page in (one, many)] for key in ("c_r", "cost"))
    assert grounds[1].shape == (-(-30 // step), -(-40 // step))
    for row, col in np.ndindex(grounds[1].shape):
        part = np.s_[row * step : (row + 1) * step, col * step : (col + 1) * step]
        ground, barred, found = grounds[0][part], bars[0][part], grounds[1][row, col]
        if (ground == NO_POINTS).all():
            assert found == bars[1][row, col] == NO_POINTS
            continue
        unknown = ground >= UNKNOWN_FROM
        assert (found >= UNKNOWN_FROM) == unknown.any()
        if not unknown.any():
            assert found == ground.max()
            assert rides[1][row, col] == pytest.approx(rides[0][part].max(), rel=0.02)
        assert (bars[1][row, col] == 0) == (barred == 0).all()
        assert np.isnan(costs[1][row, col]) == (barred != 0).any() or np.isnan(rides[1][row, col])
        assert seen[row, col] == standing[part[0], :, part[1]].any()


def test_islands_are_passable_tiles_of_small_pieces(tmp_path):
    folder = write_folder(tmp_path / "site", make_field(30, 20, easy=True))
    tiles = pq.read_table(folder / "tiles.parquet")
    at, zones = tiles.schema.get_field_index("zone"), 1 + (np.arange(len(tiles)) % 70 == 0)
    free = np.array([bar is None for bar in tiles["barred"].to_pylist()])
    numbered = tiles.set_column(at, tiles.schema.field(at), pa.array(zones, pa.int32()))
    counts = json.loads((folder / "run.json").read_text())["counts"]
    known = counts["zones"] | {"pieces": 2, "islands": 1}
    pq.write_table(numbered, folder / "tiles.parquet")
    for islands, wanted in ((1, zones > 1), (0, zones < 0)):
        list_anew(folder, counts=counts | {"zones": known | {"islands": islands}})
        page = ReadPage(write_report(folder))
        about = page.data["maps"][0]
        found = page.bytes_of(about["islands"], about) if about["islands"] else np.zeros_like(page.codes("ground"))
        assert found.sum() == (wanted & free).sum()
        assert ("island, cut off" in page.text) == wanted.any()


def test_names_are_text_and_places_of_the_machine_are_not_in_the_page(tmp_path):
    bad = "<script>alert('x')</script>\"&amp;\udce9.laz"
    plain, file = bad.replace("\udce9", ""), "<img src=x onerror=alert(1)>\"'&amp;\udce9.laz"
    places = ["/home/me/a b.laz", "C:\\me\\c.laz", "https://example.org/d.laz?key=1"]
    folder = write_folder(
        tmp_path / "odd",
        make_field(6, 5),
        views=True,
        inputs=[{"path": f"/home/me/{file}", "format": bad, "points": 7, "bytes": 5, "checksum": bad}]
        + [{"path": path, "format": "LAZ", "points": 1} for path in places],
        settings={"surveys": [f"/home/me/{file}"], "crs": "</script>"},
        warnings=[f"{places[0]} is odd"],
        vehicle=VEHICLE | {"name": plain},
        calibration={"id": plain, "vehicle": plain, "class_limits": [0.1, 0.2, 0.3]},
        survey={"name": plain, "checksum": None, "dates": [plain, plain]},
        skipped={bad: "why"},
        model=plain,
    )
    page = ReadPage(folder / "report.html")
    outline = Outline(page.text)
    assert page.text.count("<script") == 2
    assert page.data["maps"][0]["name"] == plain
    files = [row[0] for row in outline.tables["Files of the survey"][1:]]
    assert files == [file.replace("\udce9", "\\xe9"), "a b.laz", "c.laz", "d.laz"]
    assert "onerror" not in outline.attributes
    assert "a b.laz is odd" in page.text
    assert not [private for private in ("key=1", "/home", str(tmp_path)) if private in page.text]


def test_smooth_ground_looks_drivable_only_if_it_is_in_the_picture_without_script(tmp_path):
    """A steep but smooth slope, and ground of which nobody knows whether there is a way, are grey."""
    folder = write_folder(tmp_path / "easy", make_field(30, 20, easy=True, holes=0.0))
    coloured = {}
    for bar in (None, "too steep", "too little seen"):
        page = ReadPage(write_report(change_bars(folder, 0, bar)))
        source = re.search(r'class="still" src="data:image/jpeg;base64,([^"]+)"', page.text)[1]
        picture = np.asarray(Image.open(io.BytesIO(b64decode(source))).convert("RGB")).astype(int)
        ground = page.codes("ground")
        factor = picture.shape[0] // ground.shape[0]
        tiles = picture.reshape(ground.shape[0], factor, ground.shape[1], factor, 3)[:, 2:-2, :, 2:-2]
        smooth = tiles.transpose(0, 2, 1, 3, 4)[ground == 0]
        assert len(smooth) > 20
        coloured[bar] = (np.ptp(smooth, axis=-1) / smooth.max(axis=-1) > 0.15).mean()
    assert coloured[None] > 0.9
    assert max(coloured["too steep"], coloured["too little seen"]) < 0.05


def test_headline_and_bar_count_as_smooth_only_what_can_be_crossed_and_agree(tmp_path):
    folder = write_folder(tmp_path / "easy", make_field(30, 20, easy=True))
    counts = json.loads((folder / "run.json").read_text())["counts"]
    classes, tiles = counts["by_class"], counts["tiles"]
    for closed, code in (((), None), (("smooth",), "obstacle"), (("smooth",), "too little seen")):
        free = [0 if name in closed else classes[name] for name in CLASS_NAMES]
        known = {**counts["barred"], **({code: classes["smooth"]} if code else {})}
        list_anew(folder, counts=counts | {"passable": sum(free), "barred": known})
        page = write_report(change_bars(folder, 0, code)).read_text()
        unknown = counts["unknown"] + (known.get("too little seen", 0))
        assert f"can cross {share(sum(free), tiles)} of" in page
        assert f"{share(sum(free[:2]), tiles)} of the ground can be crossed and is smooth or fair to ride on." in page
        bar = page[page.index('<div class="shares"') :]
        parts = np.array(re.findall(r'<rect x="[\d.]+" width="([\d.]+)" height="4"', bar), float)
        wanted = np.array([*free, tiles - sum(free) - unknown, unknown]) / tiles
        assert np.allclose(parts, 100 * wanted, atol=0.01)
        shown = re.findall(r"</svg> ([a-z ]+) (\d+)\u00a0%", bar.partition("</div>")[0])
        assert sum(int(part) for name, part in shown if name in CLASS_NAMES) == round(100 * sum(free) / tiles)


def test_what_cannot_be_made_says_why(site, tmp_path):
    (tmp_path / "there.html").touch()
    (tmp_path / "a.html").mkdir()
    twin = shutil.copytree(site, tmp_path / "twin")
    (twin / "tiles.parquet").write_bytes(b"PAR1 and no more")
    for folder, name, error, words in (
        (site, "run.json", UsageError, r"ends in \.html"),
        (tmp_path, "b.html", BadInputError, "holds no complete run"),
        (site, "no/a.html", OutputError, "no folder"),
        (site, "there.html", OutputError, "exists"),
        (site, "a.html", OutputError, "is a folder"),
        (twin, "b.html", BadInputError, r"tiles\.parquet"),
    ):
        with pytest.raises(error, match=words):
            write_report(folder, tmp_path / name)
    bent = '{"features": [{"properties": {}, "geometry": {"type": "LineString", "coordinates": [[1]]}}]}'
    for route in (None, '{"features": []}', bent, "[" * 200, "\udcff"):
        if route is not None:
            (tmp_path / "route.geojson").write_bytes(route.encode("utf-8", "surrogateescape"))
        with pytest.raises(BadInputError, match=r"route\.geojson"):
            write_report(site, tmp_path / "b.html", route=tmp_path)
    assert not (tmp_path / "b.html").exists()


def test_a_way_lies_on_the_map(site, tmp_path):
    corners = [(110_002 * 3.0, 680_004 * 3.0), (110_020 * 3.0, 680_022 * 3.0)]
    to_lonlat = Transformer.from_crs("EPSG:32614", "OGC:CRS84", always_xy=True)
    line = {"type": "LineString", "coordinates": [to_lonlat.transform(*corner) for corner in corners]}
    about = {"name": "<b>way</b>", "length_m": 1234.5, "c_r_mean": 0.123456, "p_arrives": 0.998}
    about |= {"smallest_object_m": 0.69, "seen": "At 10 points/m2, objects narrower than 0.7 m are not seen."}
    collection = {"type": "FeatureCollection", "features": [{"type": "Feature", "properties": about, "geometry": line}]}
    (tmp_path / "route.geojson").write_text(json.dumps(collection))
    page = ReadPage(write_report(site, tmp_path / "a.html", route=tmp_path))
    (way,) = page.data["maps"][0]["ways"]
    assert np.allclose(way["lines"][0], corners, atol=0.02)
    table = dict(Outline(page.text).tables["Figures of the way"])
    wanted = {"figure": "A <b>way</b>", "mean ride cost of the tiles (rad/m)": "0.123", "length (m)": "1,234"}
    wanted["probability to arrive"] = "over 99\xa0%"
    wanted["the chance holds"] = "if nothing narrower than 0.7 m stands in the way"
    assert {name: table[name] for name in wanted} == wanted
    assert page.text.count(about["seen"]) == 1
    for text in ("route,distance_m\nway,1\n", "route,distance_m,x,y,z_m,c_r,c_r_low,c_r_high\nway,,1,2,3,,,\n", "\0"):
        (tmp_path / "profile.csv").write_text(text)
        with pytest.raises(BadInputError, match=r"profile\.csv"):
            write_report(site, tmp_path / "b.html", route=tmp_path)


def test_the_header_says_what_settings_say_and_holds_a_logo_made_anew(site, tmp_path):
    """Texts with commas and markup; of the logo the pixels alone. What is no small picture, or a link, is refused."""
    info = PngInfo()
    info.add_text("secret", "place")
    Image.new("RGB", (900, 300), "teal").save(tmp_path / "logo.png", pnginfo=info)
    words = ("page.client=Aix, <b>&", f"page.logo={tmp_path / 'logo.png'}", "page.title=North slope")
    run("report", site, "--out", tmp_path / "a.html", *(word for text in words for word in ("--set", text)), code=0)
    text = (tmp_path / "a.html").read_text()
    assert ("<h1>North slope</h1>" in text, "for Aix, &lt;b&gt;&amp;</span>" in text) == (True, True)
    logo = b64decode(re.search(r'class="logo" src="data:image/png;base64,([^"]+)"', text)[1])
    picture = Image.open(io.BytesIO(logo))
    assert (picture.size, picture.text, b"secret" in logo) == ((480, 160), {}, False)
    for header, by in (({}, "Pits &amp; Co"), ({"operator": "Ann"}, "Ann")):
        settings = json.loads((site / "run.json").read_text())["settings"] | {"provider": "Pits & Co"}
        dated = json.loads((site / "run.json").read_text())["survey"] | {"dates": ["2024-05-01", "2024-05-01"]}
        text = write_report(copy_folder(site, tmp_path / by, settings=settings, page=header, survey=dated)).read_text()
        assert f"<span>by {by}</span>" in text
        assert re.findall(r"<dt>([^<]*)</dt><dd>2024-05-01", text) == ["files written on"]
        assert text.count("2024-05-01") == 1  # of the flight nothing is known
    (tmp_path / "link.png").symlink_to(tmp_path / "logo.png")
    (tmp_path / "text.png").write_text("<svg onload='x'/>")
    for name, why in (("link.png", "it is a link"), ("text.png", "no PNG or JPEG"), ("none.png", "No such file")):
        with pytest.raises(UsageError, match=why):
            page_header(PageSettings(logo=tmp_path / name))


@pytest.mark.parametrize("name", ["logo.png", "logo.jpg"])
def test_a_logo_that_declares_more_pixels_than_memory_holds_is_refused_before_anything_is_read(site, tmp_path, name):
    (tmp_path / "surveys").mkdir()
    survey, logo = write_broken(tmp_path / "surveys/a.laz"), ("--set", f"page.logo={write_bomb(tmp_path / name)}")
    out = ("--out", tmp_path / "out")
    for words in (("report", site, *logo), ("map", survey, *out, *logo), ("batch", survey.parent, *out, *logo)):
        made = run(*words)
        assert (made.exit_code, " 65,500 pixels" in made.output or " 100,000 pixels" in made.output) == (2, True)
        assert not (tmp_path / "out").exists()


def places_of(page):
    """Rows of the table of places, by the number of the place."""
    return {re.match(r"\d+", row[0])[0]: row for row in Outline(page.text).tables["Places that have changed"][1:]}


def page_again(folder, path=None):
    """The page of the comparison in a folder, written again."""
    record = json.loads((folder / "change.json").read_text())
    write_change_report(folder, record, path or folder / "report.html")
    return ReadPage(path or folder / "report.html")


def test_tables_equal_the_counts_of_the_record(comparison):
    record = json.loads((comparison / "change.json").read_text())
    counts, tables = record["counts"], Outline(ReadPage(comparison / "report.html").text).tables
    assert counts["changed"] > 30
    kinds = tables["Tiles by what became of them"][1:]
    for name, row in zip(CHANGE_KINDS, kinds, strict=False):
        assert row[0].startswith(name)
        assert row[2:] == [f"{9 * counts['by_change'][name]:,} m²", f"{counts['by_change'][name]:,}"]
    assert [row[3] for row in kinds[6:]] == [f"{counts['compared']:,}", f"{counts['in_both'] - counts['compared']:,}"]
    classes = [[int(cell.replace(",", "")) for cell in row[1:]] for row in tables["Tiles by class"][1:]]
    assert classes == record["classes"]["tiles_before_after"]
    surveys = {row[0]: row[1:] for row in tables["Before and after"][1:]}
    assert surveys["name"] == ["pit <b>", "pit <b>"]
    assert surveys["files written on"] == ["2024-05-01", "2025-05-02 to 2025-05-03"]


def test_places_are_those_of_the_features(comparison):
    page = ReadPage(comparison / "report.html")
    features = json.loads((comparison / "change.geojson").read_text())["features"]
    rows = places_of(page)
    assert [int(row[2]) for row in rows.values()] == sorted((f["properties"]["tiles"] for f in features), reverse=True)
    to_lonlat = Transformer.from_crs("EPSG:32614", "OGC:CRS84", always_xy=True)
    spots = {spot["name"]: spot for spot in page.data["maps"][0]["places"]}
    assert set(spots) == {str(feature["id"]) for feature in features} == set(rows)
    for feature in features:
        about, number = feature["properties"], str(feature["id"])
        row, spot = rows[number], spots[number]
        assert f"rougher in {about['rougher']}" in page.text or about["rougher"] in {0, about["tiles"]}
        assert float(row[3]) == pytest.approx(about["d_height"], abs=0.0051)
        assert float(row[5]) == pytest.approx(about["d_largest"], abs=0.0051)
        assert float(row[9]) == pytest.approx(about["d_c_r"], abs=0.00051)
        assert to_lonlat.transform(spot["east"], spot["north"]) == pytest.approx(tuple(map(float, row[-2:])), abs=1e-3)


def test_values_of_the_page_are_those_of_the_raster_within_its_rounding(comparison):
    page = ReadPage(comparison / "report.html")
    changed, kinds = band(comparison / "change.tif", "changed"), page.codes("ground")
    compared = np.isfinite(changed)
    assert 0 < compared.sum() < compared.size
    np.testing.assert_array_equal(kinds, np.where(compared, changed, NOT_COMPARED))
    for key in ("d_height", "d_c_r"):
        shown, grid = page.values(key)
        roots = [np.sign(values) * np.sqrt(np.abs(values)) for values in (shown, band(comparison / "change.tif", key))]
        roots[1][~compared] = np.nan
        np.testing.assert_allclose(*roots, rtol=0, atol=grid["step"] / 2 + 1e-6, err_msg=key)


def test_nothing_found_and_nothing_compared_are_not_the_same(may, tmp_path):
    same = bumpymap.diff_surveys(may, may, tmp_path / "same", register=False)
    assert "No change was found on the 1.08 ha that were compared" in ReadPage(same.folder / "report.html").text
    folder = shutil.copytree(same.folder, tmp_path / "none")
    record = json.loads((folder / "change.json").read_text())
    record["counts"] |= {"compared": 0}
    (folder / "change.json").write_text(json.dumps(record))
    assert "is not known" in page_again(folder).text


def test_changes_lie_over_the_photo_of_a_survey_or_its_relief_if_the_map_is_the_one_compared(may, tmp_path):
    """The surveys begin at other columns."""
    folder, (row, col) = copy_folder(may, tmp_path / "may"), np.mgrid[0:ROWS, 0:COLS]
    colours = np.stack([6 * col, 8 * row, 9 * (col % 2)])
    plant_photo(folder, colours.repeat(15, axis=1).repeat(15, axis=2))
    later = write_folder(tmp_path / "june", survey(3, rut=0.1, tiles=col > 4))
    out = bumpymap.diff_surveys(folder, later, tmp_path / "out", register=False).folder

    def below():
        (key,) = {"photo", "relief"} & set(about := page_again(out).data["maps"][0])
        picture = np.asarray(Image.open(io.BytesIO(b64decode(about[key].partition(",")[2]))), float)
        return key, picture.reshape(ROWS, picture.shape[0] // ROWS, COLS - 5, -1, picture[0, 0].size).mean(axis=(1, 3))

    key, found = below()
    wanted = levelled(colours.transpose(1, 2, 0)[:, 5:].astype(float))
    assert (key, np.abs(found - wanted)[..., :2].mean() < 4) == ("photo", True)
    (folder / "rasters/photo.tif").write_bytes(b"another")
    key, found = below()
    assert (key, np.ptp(found) > 30) == ("relief", True)
    shutil.rmtree(later)
    shutil.rmtree(folder)
    assert not {"photo", "relief"} & set(page_again(out).data["maps"][0])


def test_a_change_is_seen_in_a_pixel_of_several_tiles(comparison, tmp_path, monkeypatch):
    fine, step = ReadPage(comparison / "report.html").codes("ground"), 7
    monkeypatch.setattr(change_page, "_SIDE", -(-max(fine.shape) // step))
    monkeypatch.setattr(change_page, "_STRIP_TILES", 100)
    page = page_again(comparison, tmp_path / "coarse.html")
    assert page.data["maps"][0]["metres"] == 3 * step
    kinds, (shown, _) = page.codes("ground"), page.values("d_height")
    heights = np.where(
        np.isfinite(band(comparison / "change.tif", "changed")), band(comparison / "change.tif", "d_height"), np.nan
    )
    for row, col in np.ndindex(kinds.shape):
        part = np.s_[row * step : (row + 1) * step, col * step : (col + 1) * step]
        tiles = fine[part]
        assert kinds[row, col] == next((code for code in (2, 4, 5, 3, 1) if code in tiles), tiles.max())
        if kinds[row, col] == NOT_COMPARED:
            assert np.isnan(shown[row, col])
        else:
            assert abs(shown[row, col]) == pytest.approx(np.nanmax(np.abs(heights[part])), abs=0.01)


def test_without_a_crs(tmp_path):
    local = {"georeference": Georeference(None)}
    sides = [write_folder(tmp_path / str(seed), survey(seed, rut=0.1 * (seed - 1), **local)) for seed in (1, 2)]
    change = bumpymap.diff_surveys(*sides, tmp_path / "out", register=False)
    page = ReadPage(change.folder / "report.html")
    number, row = next(iter(places_of(page).items()))
    (spot,) = [spot for spot in page.data["maps"][0]["places"] if spot["name"] == number]
    off = np.abs(np.subtract([float(cell) for cell in row[-2:]], [spot["east"], spot["north"]]))
    assert (off <= np.array(spot["size"]) / 2).all()
    assert "no place on Earth" in page.text
    assert "local_coordinates" in json.loads((change.folder / "change.geojson").read_text())


def test_the_page_holds_map_figures_and_drives(checked):
    out, result = checked
    page, stretches, offset = ReadPage(out / "check.html"), result.stretches, MapOffset.of(result.stretches)
    (about,) = page.data["maps"]
    found = about["stretches"]
    assert [spot["east"] for spot in found] == pytest.approx(stretches.easting, abs=0.01)
    assert [(spot["kind"], spot["off"]) for spot in found] == [*zip(offset.kind, offset.is_off, strict=True)]
    assert f"measured {stretches.measured[7]:.3f} rad/m, the map says {stretches.c_r[7]:.3f}" in found[7]["text"]
    assert found[4]["text"].endswith("rad/m")
    said = check_headline(result)
    assert [text in unescape(page.text) for text in said] == [True, True]
    tables = Outline(page.text).tables
    rows = tables["Map against drives"]
    classes = [f"{code} {name}, by tiles" for code, name in enumerate(CLASS_NAMES) if code in result.by_class]
    assert [row[0] for row in rows[1:]] == ["all, by the driven line", "all, by tiles", *classes]
    assert sum(int(row[1]) for row in rows[3:]) == int(rows[2][1]) == int(rows[1][1]) == 49
    (worst,) = (table for title, table in tables.items() if title.startswith("Stretches whose tiles are off"))
    measured, c_r = (np.array([float(row[at].split()[0]) for row in worst[1:]]) for at in (3, 4))
    assert 0 < len(worst) - 1 <= 10
    assert np.array([float(row[6]) for row in worst[1:]]) == pytest.approx(c_r / measured, rel=0.03)
    assert "onerror=alert(1)&gt;" in page.text
    assert "<img src=x" not in page.text
    assert page.text.count("<circle") == 49 + 50


def test_the_page_of_drives_alone_or_on_layers_that_cannot_be_drawn_has_no_map(site, tmp_path):
    result = made_up_check(8, ground=False, drives=2)
    drives = (replace(result.drives[0], warnings=("drive 1: no standstill", "too fast")), result.drives[1])
    write_check(replace(result, drives=drives), tmp_path)
    page = ReadPage(tmp_path / "check.html")
    assert page.data["maps"] == []
    assert "Map against drives" not in Outline(page.text).tables
    assert "Spearman" not in page.text
    assert "<h1>Drives measured: drive 1, drive 2</h1>" in page.text
    assert "<li>drive 1: no standstill</li>\n<li>drive 1: too fast</li>" in page.text
    later = copy_folder(site, tmp_path / "later", name="later")
    result, ground = on_site(made_up_check(50), later)
    (later / "tiles.parquet").unlink()
    write_check(result, tmp_path / "out", ground=ground)
    assert ReadPage(tmp_path / "out" / "check.html").data["maps"] == []


@pytest.mark.parametrize(
    ("rank", "ratio", "inside", "words"),
    [
        (0.95, 1.14, 0.79, "the map holds in rank and level, but is surer than it may be"),
        (0.95, 1.16, 0.79, "the map ranks the ground rightly, but its level is off"),
        (0.7, 2.0, 0.79, "the map ranks the ground only roughly, and its level is off"),
        (-0.9, 1.0, 0.79, "the map does not rank this ground as the vehicle felt it"),
    ],
)
def test_each_verdict_follows_from_its_own_figures(rank, ratio, inside, words):
    result = made_up_check(40)
    figures = {"spearman": rank, "median_ratio": ratio, "inside": inside, "median_error": 0.11, "way_m": 412.3}
    other = {"spearman": 0.86, "median_ratio": 0.39, "median_error": 0.61, "inside": 0.0}
    line, tiles = replace(result.agreement_by_line, **figures), replace(result.agreement, **other)
    by_line, by_tiles = check_headline(replace(result, agreement_by_line=line, agreement=tiles))
    assert f", {words}: over 412 m in 40 stretches it reads " in by_line
    for figure in ("less than 11 %", f"{100 * inside:.0f} % of the drives' readings", f"is {rank:.2f}."):
        assert figure in by_line
    assert ", the map ranks the ground rightly, but its level is off: over " in by_tiles
    for figure in ("reads 61 % low", "less than 61 %", " 0 % of the drives' readings", "is 0.86."):
        assert figure in by_tiles


@pytest.mark.parametrize(
    ("ratio", "words"), [(0.7, "is off; the ground driven is too even"), (1.05, "holds; the ground")]
)
def test_even_ground_cannot_be_ranked(ratio, words):
    result = made_up_check(40)
    even = replace(result.stretches, measured=np.full(40, 0.1))
    figures = replace(result.agreement, spearman=0.1, median_ratio=ratio, inside=0.3)
    (said,) = check_headline(replace(result, agreement=figures, stretches=even, agreement_by_line=None))
    assert f"the level of the map {words}" in said


# ---- batches ----


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


def test_what_failed_comes_first_then_what_can_be_crossed_best_and_names_link_to_reports_that_exist():
    rows = [
        done("a", share_passable=0.2),
        SurveyRow("b", "not reached"),
        SurveyRow("c", "failed", "broken"),
        done("d e"),
    ]
    rows.append(SurveyRow("e", "already done"))
    found = Outline(index_page(rows, {"d e": SurveyView(has_report=True)}, ["summary.csv"], "night"))
    named = [cell["data-v"] for cell in found.elements["th"] if cell.get("scope") == "row"]
    assert named == ["c", "b", "d e", "a", "e"]
    assert [link["href"] for link in found.elements["a"]] == ["summary.csv", "d%20e/report.html"]
    assert "5 surveys: 3 done (1 of them earlier), 1 not reached, 1 failed; 2.57 ha mapped\n" in found.text
    assert "60%" in found.text
    assert "15.0% unknown, mostly too few points" in found.text
    assert "smooth 50.0%, fair 20.0%, rough 10.0%, very rough 5.0%, unknown 15.0%" in found.text


def test_a_page_of_500_surveys_is_small():
    rows = [done(f"survey_{number:03}", min_x=5e5 + number, message="x" * 100) for number in range(500)]
    views = {row.name: SurveyView("A" * 2_400, has_report=True) for row in rows}
    assert len(index_page(rows, views, ["summary.csv"], "night").encode()) < 2_000_000


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
