"""report.html holds what the layers hold, says it in tables, asks nobody for anything, and trusts no name."""

import io
import json
import re
import shutil
from base64 import b64decode

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from cost_maps import make_field
from page_outline import Outline, ReadPage, require_no_requests
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from pyproj import Transformer
from route_maps import VEHICLE, change_bars, copy_folder, list_anew, write_folder
from small_surveys import band, run, write_bomb, write_broken

from bumpymap.core import CLASS_NAMES, NO_CLASS, OBSTACLE, BadInputError, OutputError, PageSettings, UsageError
from bumpymap.views import page_header, write_report
from bumpymap.views.page.tiles import NO_POINTS, UNKNOWN_FROM
from bumpymap.views.words import share


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
