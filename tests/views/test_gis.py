"""Styles and project for GIS as XML, and what QGIS makes of the files of a map, a comparison and a check."""

import json
import re
import subprocess
from collections import Counter
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import geopandas
import numpy as np
import pytest
from check_records import made_up_check, on_site
from cost_maps import make_field, survey, table_of
from page_outline import ReadPage
from pyproj import CRS
from route_maps import RUN, copy_folder, plant_photo, write_folder
from skimage.color import deltaE_ciede2000, rgb2lab
from small_surveys import run, write_survey
from tile_maps import UTM, MadeUpMap, make_route

import bumpymap
from bumpymap.check.pipeline import write_check
from bumpymap.core import BARRED_TEXT, CHANGE_KINDS, CLASS_NAMES, NO_CLASS, OBJECT_NAMES, REASON_TEXT, Georeference
from bumpymap.layers import OFF_KINDS, PRODUCT_NAMES, MapOffset, colours, open_map, write_products
from bumpymap.rating import Calibration
from bumpymap.route.output import write_route
from bumpymap.views.gis.project import write_map_views, write_project, write_styles

RECORD = RUN | {"metres_per_unit": {"horizontal": 1.0}, "cost": {"speeds_mps_at_c_r_radpm": [[2.0, 0.1]]}}
INTERVALS = ("under 0.1", "0.1 to 0.2", "0.2 to 0.4", "0.4 and more, or too steep, or drives fail")


def write_layers(table, folder, *, local=False, **manifest):
    return write_products(table, folder, views=write_map_views, local=local, manifest=RUN | manifest)[0]


@pytest.fixture(name="folder", scope="module")
def folder_fixture(tmp_path_factory, cost_map):
    folder = tmp_path_factory.mktemp("site of a user")
    write_layers(table_of(cost_map), folder)
    return folder


@pytest.fixture
def alone(tmp_path):
    """A folder with names of layers, for styles that do not read any."""
    (tmp_path / "rasters").mkdir()
    for name in PRODUCT_NAMES:
        (tmp_path / name).touch()
    return tmp_path


def read(path):
    return ET.parse(path).getroot()  # noqa: S314 (our own file)


def palette(style):
    return {
        int(entry.get("value")): (entry.get("label"), entry.get("color"), int(entry.get("alpha")))
        for entry in style.iter("paletteEntry")
    }


def expected(names, palette_of):
    visible = ((value, name) for value, name in names if palette_of[value][3])
    return {
        value: (name, "#{:02x}{:02x}{:02x}".format(*palette_of[value]), palette_of[value][3]) for value, name in visible
    }


def styled(folder, **record):
    for path in folder.rglob("*.qml"):
        path.unlink()
    write_styles(folder, RECORD | record)
    return {path.relative_to(folder).as_posix(): read(path) for path in folder.rglob("*.qml")}


def test_every_visible_value_has_the_colour_of_the_table_and_its_name(alone):
    styles = styled(alone)
    labels = [f"{name}: c_r {text}" for name, text in zip(CLASS_NAMES, INTERVALS, strict=True)]
    assert palette(styles["rasters/class.qml"]) == expected(enumerate(labels), colours.CLASS_COLOURS)
    assert palette(styles["rasters/reason.qml"]) == expected(REASON_TEXT.items(), colours.REASON_SHADES)
    assert palette(styles["rasters/barred.qml"]) == expected(BARRED_TEXT.items(), colours.BARRED_COLOURS)
    assert palette(styles["rasters/obstacle.qml"]) == expected(enumerate(OBJECT_NAMES), colours.OBJECT_COLOURS)
    for name in ("cost.qml", "tiles.qml"):
        root = styles[name]
        rules = {rule.get("label"): rule for rule in root.iter("rule")}
        assert [*rules] == [*labels, "cannot be crossed", "not known"]
        wanted = [*(colours.CLASS_COLOURS[code] for code in range(4)), colours.CLOSED_COLOUR, colours.UNKNOWN_COLOUR]
        for rule, colour in zip(rules.values(), wanted, strict=True):
            symbol = root.find(f".//symbol[@name='{rule.get('symbol')}']")
            assert symbol.find(".//Option[@name='color']").get("value") == ",".join(map(str, colour))


def test_the_ride_cost_has_the_colours_of_the_classes_of_the_vehicle(alone):
    (renderer,) = styled(alone)["rasters/roughness.qml"].iter("rasterrenderer")
    assert (renderer.get("type"), renderer.get("band")) == ("singlebandpseudocolor", "1")
    for number, (item, value) in enumerate(zip(renderer.iter("item"), (0.05, 0.15, 0.3, 0.5), strict=True)):
        assert float(item.get("value")) == pytest.approx(value)
        assert item.get("label") == f"{value} rad/m"
        assert item.get("color") == "#{:02x}{:02x}{:02x}".format(*colours.CLASS_COLOURS[number])
    legend = renderer.find(".//rampLegendSettings")
    assert [legend.get(key) for key in ("useContinuousLegend", "minimumLabel", "maximumLabel")] == [
        *("1", "0.05 and less", "0.5 and more")
    ]


def test_classes_of_the_paper_are_not_said_to_be_intervals_of_ride_cost(alone):
    styles = styled(alone, settings={"compat": "paper"})
    assert [label for label, _, _ in palette(styles["rasters/class.qml"]).values()] == list(CLASS_NAMES)


def test_the_relief_is_smooth_and_in_the_unit_of_the_crs(alone):
    foot = {"metres_per_unit": {"horizontal": 1200 / 3937, "vertical": 1.0}}
    for record, factor in (({}, 1.0), (foot, 3937 / 1200)):
        styles = styled(alone, **record)
        root = styles["rasters/relief.qml"]
        assert ET.tostring(styles["rasters/heightmap.qml"]) == ET.tostring(root)
        renderer, sampler = root.find("pipe/rasterrenderer"), root.find("pipe/rasterresampler")
        assert renderer.get("type") == "hillshade"
        assert float(renderer.get("zfactor")) == pytest.approx(factor)
        assert {sampler.get("zoomedInResampler"), sampler.get("zoomedOutResampler")} == {"bilinear"}
    assert root.find("pipe/resamplingStage").text == "resamplingFilter"
    assert styled(alone)["rasters/class.qml"].find("pipe/rasterresampler").get("zoomedInResampler") is None


def test_a_photo_lies_as_light_over_the_map_in_place_of_the_relief(folder, tmp_path):
    lit = plant_photo(copy_folder(folder, tmp_path / "layers"), 90)  # of one grey
    write_project(lit, json.loads((folder / "run.json").read_text()))
    root = read(lit / "map.qgs")
    shown = {leaf.get("id"): leaf.get("checked") for leaf in root.find("layer-tree-group").iter("layer-tree-layer")}
    assert (shown["bumpymap_photo_tif"], shown["bumpymap_relief_tif"]) == ("Qt::Checked", "Qt::Unchecked")
    layers = {layer.find("id").text: layer for layer in root.find("projectlayers")}
    grey, tint = (layers[f"bumpymap_photo_tif{part}"] for part in ("", "_colours"))
    assert [[*shown].index(layer.find("id").text) for layer in (grey, tint)] == [
        *(0, [*shown].index("bumpymap_cost_fgb_closed") + 1)
    ]
    for layer in (grey, tint):
        renderer = layer.find("pipe/rasterrenderer")
        bands = [renderer.get(key) for key in ("type", "redBand", "blueBand", "alphaBand")]
        assert bands == ["multibandcolor", "1", "3", "4"]  # QGIS takes the mask for a fourth band
        assert float(renderer.find(".//maxValue").text) == pytest.approx(255 * 90 / 128, rel=1e-4)
    assert not {leaf.get("id") for leaf in root.find("Layouts").iter("layer-tree-layer")} & {"bumpymap_photo_tif"}


@pytest.mark.parametrize("crs", ["EPSG:32614+5703", None])
def test_a_project_has_the_horizontal_crs_or_none(tmp_path, crs):
    cost_map = make_field(4, 4, georeference=Georeference(crs and CRS.from_user_input(crs)))
    write_layers(table_of(cost_map), tmp_path, local=crs is None)
    root = read(tmp_path / "map.qgs")
    assert (root.find("projectCrs") is None) == (crs is None)
    assert root.find("properties/SpatialRefSys/ProjectionsEnabled").text == ("0" if crs is None else "1")
    references = [reference.find("wkt").text for reference in root.iter("spatialrefsys")]
    assert len(references) > 5
    assert {text and CRS.from_wkt(text).to_epsg() for text in references} == {crs and 32614}


def test_a_project_says_survey_vehicle_and_calibration_and_no_name_breaks_its_xml(folder, tmp_path):
    crs = CRS.from_wkt(CRS.from_epsg(32614).to_wkt().replace("WGS 84 / UTM", "mine \x01 / UTM", 1))
    survey = {"name": "Pit \x01 <7> \udce9 &", "dates": None}
    record = RECORD | {"survey": survey, "crs": {"name": crs.name, "wkt": crs.to_wkt()}}
    record["counts"] = {"seen_sizes": {"points_per_m2": 10.0, "smallest_object_m": 0.69}}
    (tmp_path / "rasters").mkdir()
    for name in ("rasters/class.tif", "rasters/heightmap.tif"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    write_project(tmp_path, record)
    root = read(tmp_path / "map.qgs")
    assert root.find("title").text == r"Pit \x01 <7> \xe9 &: ride cost"
    abstract = root.find("projectMetadata/abstract").text
    for part in ("warthog", "c0ffee", "smooth: c_r under 0.1", "objects narrower than 0.7 m are not seen"):
        assert part in abstract
    sources = {layer.find("datasource").text for layer in root.find("projectlayers")}
    assert sources == {"./rasters/class.tif", "./rasters/heightmap.tif"}
    known = CRS.from_wkt(root.find("projectCrs/spatialrefsys/wkt").text)
    assert known.name == r"mine \x01 / UTM zone 14N"


SCRIPT = Path(__file__).with_name("load_in_qgis.py")
RASTERS = {name: "paletted" for name in PRODUCT_NAMES if name.endswith(".tif")}
RASTERS |= dict.fromkeys(("rasters/roughness.tif", "cost.tif", "rasters/speed.tif"), "singlebandpseudocolor")
RASTERS |= dict.fromkeys(("rasters/heightmap.tif", "rasters/relief.tif"), "hillshade")
AREAS = ("cost.geojson", "cost.fgb", "tiles.gpkg")


def load(folder):
    """What QGIS makes of the files in a folder."""
    report = folder.parent / f"{folder.name}.json"
    command = ["/usr/bin/python3", str(SCRIPT), str(folder), str(report)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(report.read_text(encoding="utf-8"))


@pytest.fixture(name="seen", scope="module")
def seen_fixture(tmp_path_factory, cost_map):
    """Layers as QGIS loads them; its version here may not read Parquet, so tiles come as GeoPackage."""
    folder = tmp_path_factory.mktemp("layers")
    write_layers(table_of(cost_map), folder, survey=RUN["survey"] | {"name": "Pit 7"})
    tiles = geopandas.read_parquet(folder / "tiles.parquet").drop(columns=["bbox", "heights"], errors="ignore")
    tiles.to_file(folder / "tiles.gpkg", driver="GPKG")
    return load(folder)


@pytest.mark.qgis
def test_every_layer_opens_with_its_renderer(seen):
    layers = seen["layers"]
    assert {name: layer["renderer"] for name, layer in layers.items()} == {
        **RASTERS,
        **dict.fromkeys(AREAS, "RuleRenderer"),
    }
    assert all(layer["valid"] and layer["crs_valid"] for layer in layers.values())
    assert {name: layer["crs"] for name, layer in layers.items()} == {
        name: "EPSG:4326" if name == "cost.geojson" else "EPSG:32614" for name in layers
    }
    assert all(layer["name"] == Path(name).stem for name, layer in layers.items())
    assert all(layer["colours"] > 1 for layer in layers.values())


@pytest.mark.qgis
def test_every_area_is_drawn_and_none_as_what_it_is_not(seen, cost_map):
    known = cost_map.class_id != NO_CLASS
    table = table_of(cost_map).tiles.read(("passable",), table_of(cost_map).tiles.window)
    drawn = seen["layers"]["tiles.gpkg"]["drawn"]
    assert "nothing" not in drawn
    assert drawn["not known"] == int((~known).sum())
    assert sum(drawn.values()) == len(known)
    assert drawn["cannot be crossed"] == int(known.sum() - table["passable"].sum())
    regions = seen["layers"]["cost.fgb"]["drawn"]
    assert regions == seen["layers"]["cost.geojson"]["drawn"]
    assert "nothing" not in regions
    assert sum(regions.values()) == seen["layers"]["cost.fgb"]["features"]
    assert set(regions) == set(drawn)


@pytest.mark.qgis
def test_the_project_opens_as_a_map(seen):
    project = seen["project"]
    assert (project["read"], project["error"], project["crs"]) == (True, "", "EPSG:32614")
    assert project["title"] == "Pit 7: ride cost"
    assert "warthog" in project["abstract"]
    layers = {Path(layer["source"]).name: layer for layer in project["layers"].values()}
    renderers = {Path(name).name: kind for name, kind in RASTERS.items()} | {"cost.fgb": "RuleRenderer"}
    assert {name: layer["renderer"] for name, layer in layers.items()} == renderers
    assert all(layer["valid"] and layer["crs"] == "EPSG:32614" for layer in layers.values())
    assert (layers["class.tif"]["hard_light"], layers["relief.tif"]["hard_light"]) == (False, True)
    assert all(found for *_, found in project["tree"])
    shown = {layer_id for layer_id, is_shown, _ in project["tree"] if is_shown}
    view = ("obstacle_tif_dark", "cost_fgb_closed", "roughness_tif", "relief_tif")
    assert shown == {f"bumpymap_{name}" for name in view}
    assert not [row for row in project["rows"] if "Band" in row]
    assert project["colours"] > 100  # four classes, each as bright as the relief under it
    west, south, east, north = layers["class.tif"]["extent"]
    left, bottom, right, top = project["extent"]
    assert left < west < east < right
    assert bottom < south < north < top
    assert top - bottom < 1.3 * (north - south)
    (page,) = project["pages"]
    assert page["items"] == [1, 1, 1, 1, 3]
    assert {"Pit 7: ride cost", f"1:{page['scale']:.0f} on A4"} < set(page["texts"])
    assert "Vehicle: warthog." in "\n".join(page["texts"]).split("\n")
    assert page["legend"] == [f"bumpymap_{name}" for name in ("roughness_tif", "cost_fgb_closed", "obstacle_tif_dark")]
    assert page["colours"] > 100


@pytest.mark.qgis
def test_every_field_has_a_name_and_every_layer_says_what_is_under_the_pointer(seen):
    layers, project = seen["layers"], seen["project"]["layers"]
    for layer in (layers["cost.geojson"], layers["cost.fgb"], layers["tiles.gpkg"], project["bumpymap_cost_fgb"]):
        assert set(layer["unnamed"]) <= {"fid"}  # GeoPackage adds it
    for layer in project.values():
        assert any(layer["tips"])
    sentence = r"C_r \d.\d\d rad/m \(\d.\d\d to \d.\d\d\): (very )?\w+; (can|cannot) be crossed"
    for said in (project["bumpymap_roughness_tif"], layers["cost.fgb"], layers["tiles.gpkg"]):
        assert sum(bool(re.match(sentence, tip)) for tip in said["tips"]) > 3
    assert any("; slope " in tip for tip in layers["tiles.gpkg"]["tips"])


def legend(names, palette_of):
    return [[name, "#{:02x}{:02x}{:02x}".format(*palette_of[code])] for code, name in enumerate(names)]


@pytest.mark.qgis
def test_a_comparison_shows_its_kinds_as_pixels_and_places(tmp_path):
    later = survey(3, rut=0.1, c_r=3.0)
    later.c_r[600:] = np.nan  # the ride over the end of the rut is not known
    before, after = write_folder(tmp_path / "may", survey(1)), write_folder(tmp_path / "june", later)
    change = bumpymap.diff_surveys(before, after, tmp_path / "out")
    seen = load(change.folder)
    layers = seen["layers"]
    raster, places = layers["change.tif"], layers["change.geojson"]
    assert (raster["renderer"], raster["bands"], raster["crs"]) == ("paletted", [9], "EPSG:32614")
    assert raster["values"] == [0, 1, 2, 3, 4, 5]
    assert raster["legend"] == [[*entry, 255] for entry in legend(CHANGE_KINDS, colours.CHANGE_COLOURS)]
    assert raster["colours"] >= 3  # unchanged ground, and more than one kind of change
    assert places["renderer"] == "RuleRenderer"
    assert [entry[:2] for entry in places["legend"]] == legend(CHANGE_KINDS, colours.CHANGE_COLOURS)[1:]
    assert places["drawn"] == Counter(about["kind"] for about in change.field.regions)
    assert places["features"] == len(change.field.regions) > 0
    hidden = {"change_geojson", "change_tif_d_c_r", "change_tif_d_height", "class_tif"}
    over_map(seen["project"], {"change_tif", "relief_tif", "cost_fgb_closed"}, hidden)
    most = float(np.nanmax(np.abs(change.field.d_c_r)))
    ends = seen["project"]["layers"]["bumpymap_change_tif_d_c_r"]["values"]
    assert (ends[0], ends[4], ends[-1]) == pytest.approx((-most, 0, most))


STRANGE = "[% 6*7 %] it's [[% env('SECRET') %]% \\' OR 1=1 -- $CURRENT_DATE %]"
"""A name that QGIS would evaluate in a label, and that would end a text in an expression."""
INVISIBLE = "\N{WORD JOINER}"
STRANGE_CRS = CRS.from_wkt(UTM.crs.to_wkt().replace(UTM.crs.name, STRANGE))


@pytest.fixture(name="strange", scope="module")
def strange_fixture(tmp_path_factory):
    """Folders with a project; every text in them that a stranger may give is that name."""
    root = tmp_path_factory.mktemp("strange")
    calibration = RUN["calibration"] | {"vehicle": STRANGE, "preferences": {"description": STRANGE}}
    about = {"survey": RUN["survey"] | {"name": STRANGE}, "calibration": calibration}
    pair = [replace(made, georeference=Georeference(STRANGE_CRS)) for made in (survey(1), survey(3, rut=0.1, c_r=3.0))]
    maps = [
        write_folder(root / name, made, views=name == "map", **about)
        for name, made in zip(("before", "map"), pair, strict=True)
    ]
    found, ground = on_site(made_up_check(50), maps[1])
    write_route(make_route(STRANGE), ground, root / "route", manifest={})
    write_check(found, root / "check", ground=ground)
    bumpymap.diff_surveys(*maps, root / "diff", register=False)
    return root


def evaluated(label):
    """A label of a page as QGIS shows it: no date may be in it, and as expressions only texts in quotes."""
    assert "$CURRENT_DATE" not in label
    parts = re.split(r"\[%(.*?)%\]", label, flags=re.DOTALL)
    parts[1::2] = [re.fullmatch(r" *'(\w*)' *", part)[1] for part in parts[1::2]]
    return "".join(parts)


@pytest.mark.parametrize("name", ["map", "route", "diff", "check"])
def test_labels_hold_no_expression_of_strangers(strange, name):
    root = read(strange / name / "map.qgs")
    labels = "".join(evaluated(item.get("labelText")) for item in root.iter("LayoutItem"))
    assert labels.count(STRANGE) == 4
    legend = "".join(entry.get("label") for entry in root.iterfind(".//*[@label]"))
    assert "[%" not in legend
    assert legend.replace(INVISIBLE, "").count(STRANGE) == (name == "route")
    assert not [one for one in root.iterfind(".//*[@name]") if "[%" in one.get("name")]


@pytest.mark.qgis
def test_qgis_evaluates_no_text_of_strangers(strange, monkeypatch):
    monkeypatch.setenv("SECRET", "hunter2")
    vehicle = json.loads(Calibration.shipped("warthog").to_json())
    vehicle["vehicle"] |= {"name": STRANGE, "description": STRANGE}
    (strange / "vehicle.json").write_text(json.dumps(vehicle))
    write_survey(strange / "flights" / f"{STRANGE}.las", epsg=STRANGE_CRS)
    run("batch", strange / "flights", "--out", strange / "night", "--set", f"calibration={strange / 'vehicle.json'}")
    (night,) = (strange / "night").glob("*/map.qgs")
    for folder in (*(strange / name for name in ("map", "route", "diff", "check")), night.parent):
        project = load(folder)["project"]
        texts = "\n".join(project["pages"][0]["texts"]).replace(INVISIBLE, "")
        assert texts.count(STRANGE) == 4 + (folder.name == "route")
        assert project["title"].startswith(f"{STRANGE}: ")
        assert "hunter2" not in json.dumps(project)
        if folder.name == "route":
            assert [*project["layers"]["bumpymap_route_geojson_ways"]["drawn"].values()] == [1]
            (tip,) = project["layers"]["bumpymap_route_geojson_ways"]["tips"]
            assert tip.startswith(f"{STRANGE}: ")


def over_map(project, shown, hidden=frozenset()):
    """Check that a project of a run shows its layers over those of the map, and has a page to print."""
    assert (project["read"], project["error"], project["crs"]) == (True, "", "EPSG:32614")
    assert {name for name, is_shown, _ in project["tree"] if is_shown} == {f"bumpymap_{name}" for name in shown}
    assert {name for name, is_shown, _ in project["tree"] if not is_shown} >= {f"bumpymap_{name}" for name in hidden}
    assert all(layer["valid"] and any(layer["tips"]) for layer in project["layers"].values())
    assert not [name for layer in project["layers"].values() for name in layer.get("unnamed", ())]
    assert not [row for row in project["rows"] if "Band" in row]
    assert project["colours"] > 10
    assert project["pages"][0]["items"] == [1, 1, 1, 1, 3]


@pytest.mark.qgis
def test_ways_are_drawn_over_the_map(tmp_path, site):
    ways, source = tmp_path / "way", open_map(site)
    way = make_route(name="it's a way")
    write_route(way, source, ways, manifest={})
    seen = load(ways)["project"]
    shown = {"obstacle_tif_dark", "cost_fgb_closed", "roughness_tif", "relief_tif"}
    over_map(seen, {"route_geojson_stops", "route_geojson_ways", *shown})
    drawn = [seen["layers"][f"bumpymap_route_geojson_{part}"]["drawn"] for part in ("stops", "ways")]
    assert drawn[0] == {"start": 1, "goal": 1}
    assert {label.split(":")[0]: count for label, count in drawn[1].items()} == {way.name: 1}


@pytest.mark.qgis
def test_stretches_are_drawn_by_how_far_the_map_is_off(tmp_path):
    result = made_up_check(60, noise=0.4, unknown=[4])
    write_check(result, tmp_path / "out", ground=MadeUpMap.around())
    seen = load(tmp_path / "out")
    layer = seen["layers"]["check.geojson"]
    assert layer["renderer"] == "RuleRenderer"
    assert [entry[:2] for entry in layer["legend"]] == legend(OFF_KINDS, colours.OFF_COLOURS)
    assert layer["drawn"] == Counter(OFF_KINDS[kind] for kind in MapOffset.of(result.stretches).kind.tolist())
    assert layer["features"] == 60
    assert layer["colours"] > 6
    found = seen["project"]["layers"]["bumpymap_check_geojson"]
    assert (found["drawn"], found["unnamed"]) == (layer["drawn"], [])
    assert re.match(r"drive 1: measured \d.\d\d, map \d.\d\d rad/m: map ", found["tips"][0])


SEEN_BY = {
    "protanopia": ((0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998)),
    "deuteranopia": ((0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.011820, 0.042940, 0.968881)),
    "tritanopia": ((1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602), (0.004733, 0.691367, 0.303900)),
}
"""Linear red, green and blue as seen without one kind of cones (Machado, Oliveira and Fernandes 2009)."""


def parts_of(text):
    return [int(text[at : at + 2], 16) for at in (1, 3, 5)]


def least_difference(found, seen):
    """The least CIEDE2000 between two of the colours."""
    linear = np.array([parts_of(text) for text in found]) / 255
    linear = np.where(linear <= 0.04045, linear / 12.92, ((linear + 0.055) / 1.055) ** 2.4) @ np.transpose(seen)
    linear = linear.clip(0, 1)
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    lab = rgb2lab(shown)
    return min(deltaE_ciede2000(one, other) for one, other in combinations(lab, 2))


@pytest.mark.parametrize("seen", SEEN_BY.values(), ids=SEEN_BY)
def test_colour_blind_readers_tell_classes_reasons_and_bars_apart_and_neighbouring_classes_in_grey(folder, seen):
    classes = [colour for _, colour, _ in palette(read(folder / "rasters/class.qml")).values()]
    assert min(least_difference(pair, [[0.2126, 0.7152, 0.0722]] * 3) for pair in pairwise(classes)) > 12
    reasons = {code: colour for code, (_, colour, _) in palette(read(folder / "rasters/reason.qml")).items()}
    codes = ReadPage(folder / "report.html").data["codes"]
    on_page = ["#{:02x}{:02x}{:02x}".format(*one) for one in (*codes["classColours"], codes["unknownColour"])]
    assert on_page[:-1] == classes
    assert least_difference(on_page, seen) > 12
    assert least_difference([*classes, *(reasons[code] for code in reasons if code)], seen) > 12
    assert least_difference([bar for _, bar, _ in palette(read(folder / "rasters/barred.qml")).values()], seen) > 12


def test_the_ride_cost_has_one_ramp_on_the_page_and_in_qgis(folder):
    items = list(read(folder / "rasters/roughness.qml").iter("item"))
    site = ReadPage(folder / "report.html").data["maps"][0]
    grid, ramp = next(grid for grid in site["grids"] if grid["key"] == "c_r"), site["ramps"]["c_r"]
    ends = np.exp(grid["low"] + grid["step"] * np.linspace(0, 254, len(ramp)))
    parts = np.array([parts_of(item.get("color")) for item in items], float)
    values = [float(item.get("value")) for item in items]
    wanted = np.stack([np.interp(ends, values, part) for part in parts.T], axis=1)
    assert np.abs([parts_of(text) for text in ramp] - wanted).max() <= 0.5 + 1e-6
