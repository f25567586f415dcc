"""What QGIS makes of the files of a map, a comparison and a check when they are dragged in, and of map.qgs."""

import json
import subprocess
from collections import Counter
from pathlib import Path

import geopandas
import numpy as np
import pytest
from check_records import made_up_check
from route_maps import write_folder
from route_records import MadeUpMap
from survey_pairs import survey

import bumpymap
from bumpymap.check.pipeline import write_check
from bumpymap.core import CHANGE_KINDS, NO_CLASS, CostTable, Georeference
from bumpymap.layers import write_products
from bumpymap.layers.check_vectors import OFF_KINDS, MapOffset
from bumpymap.layers.colours import CHANGE_COLOURS, OFF_COLOURS
from bumpymap.layers.products import PRODUCT_NAMES
from bumpymap.views import write_map_views

pytestmark = pytest.mark.qgis

SCRIPT = Path(__file__).with_name("load_in_qgis.py")
RASTERS = {
    "rasters/class.tif": "paletted",
    "rasters/reason.tif": "paletted",
    "rasters/barred.tif": "paletted",
    "rasters/obstacle.tif": "paletted",
    "rasters/passage.tif": "paletted",
    "rasters/roughness.tif": "singlebandpseudocolor",
    "cost.tif": "singlebandpseudocolor",
    "rasters/heightmap.tif": "hillshade",
    "rasters/relief.tif": "hillshade",
}
RASTERS = {name: kind for name, kind in RASTERS.items() if name in PRODUCT_NAMES}
AREAS = ("cost.geojson", "cost.fgb", "tiles.gpkg")
RUN = {
    "calibration": {"id": "c0ffee", "vehicle": "warthog", "class_limits": (0.1, 0.2, 0.4)},
    "survey": {"name": "Pit 7"},
}


def seen_by_qgis(folder, cost_map, *, local=False):
    """Write layers and let QGIS load them; its version here may not read Parquet, so tiles come as GeoPackage."""
    write_products(CostTable.of(cost_map), folder, views=write_map_views, local=local, manifest=RUN)
    tiles = geopandas.read_parquet(folder / "tiles.parquet", columns=["geometry", "class", "passable", "c_r"])
    tiles.to_file(folder / "tiles.gpkg", driver="GPKG")
    return load(folder)


def load(folder):
    """What QGIS makes of the files in a folder."""
    report = folder.parent / f"{folder.name}.json"
    command = ["/usr/bin/python3", str(SCRIPT), str(folder), str(report)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(report.read_text(encoding="utf-8"))


@pytest.fixture(name="seen", scope="module")
def seen_fixture(tmp_path_factory, cost_map):
    return seen_by_qgis(tmp_path_factory.mktemp("layers"), cost_map)


@pytest.fixture(name="seen_local", scope="module")
def seen_local_fixture(tmp_path_factory, make_field):
    cost_map = make_field(20, 15, georeference=Georeference(None))
    return seen_by_qgis(tmp_path_factory.mktemp("local"), cost_map, local=True)


def test_every_layer_opens_with_its_renderer(seen):
    layers = seen["layers"]
    assert {name: layer["renderer"] for name, layer in layers.items()} == {
        **RASTERS,
        **dict.fromkeys(AREAS, "categorizedSymbol"),
    }
    assert all(layer["valid"] and layer["crs_valid"] for layer in layers.values())
    assert {name: layer["crs"] for name, layer in layers.items()} == {
        name: "EPSG:4326" if name == "cost.geojson" else "EPSG:32614" for name in layers
    }
    assert all(layer["name"] == Path(name).stem for name, layer in layers.items())
    assert all(layer["colours"] > 1 for layer in layers.values())


def test_every_area_is_drawn_and_none_as_what_it_is_not(seen, cost_map):
    known = cost_map.class_id != NO_CLASS
    table = CostTable.of(cost_map).tiles.read(("passable",), CostTable.of(cost_map).tiles.window)
    drawn = seen["layers"]["tiles.gpkg"]["drawn"]
    assert "nothing" not in drawn
    assert drawn["unknown"] == int((~known).sum())
    assert sum(drawn.values()) == len(known)
    assert drawn["not passable"] == int(known.sum() - table["passable"].sum())
    regions = seen["layers"]["cost.fgb"]["drawn"]
    assert regions == seen["layers"]["cost.geojson"]["drawn"]
    assert "nothing" not in regions
    assert sum(regions.values()) == seen["layers"]["cost.fgb"]["features"]
    assert set(regions) == set(drawn)


def test_the_project_opens_as_a_map(seen):
    project = seen["project"]
    assert project["read"]
    assert not project["error"]
    assert project["title"] == "Pit 7: ride cost"
    assert "warthog" in project["abstract"]
    assert project["crs"] == "EPSG:32614"
    fails = project["layers"].pop("bumpymap_roughness_tif_p_fail")
    assert fails["values"] == [0.5, 1.0]
    layers = {Path(layer["source"]).name: layer for layer in project["layers"].values()}
    renderers = {Path(name).name: kind for name, kind in RASTERS.items()} | {"cost.fgb": "categorizedSymbol"}
    assert {name: layer["renderer"] for name, layer in layers.items()} == renderers
    assert all(layer["valid"] and layer["crs"] == "EPSG:32614" for layer in layers.values())
    assert layers["class.tif"]["multiply"]
    assert not layers["relief.tif"]["multiply"]
    assert all(found for *_, found in project["tree"])
    shown = {layer_id for _, _, layer_id, is_shown, _ in project["tree"] if is_shown}
    assert shown - {"bumpymap_reason_tif"} == {"bumpymap_class_tif", "bumpymap_relief_tif"}
    assert project["colours"] > 100  # four classes, each as bright as the relief under it
    west, south, east, north = layers["class.tif"]["extent"]
    assert project["extent"][0] < west < east < project["extent"][2]
    assert project["extent"][1] < south < north < project["extent"][3]
    assert project["extent"][3] - project["extent"][1] < 1.3 * (north - south)


def test_a_map_without_a_crs_lies_where_its_coordinates_say(seen_local):
    project = seen_local["project"]
    assert not project["crs_valid"]
    for layer in project["layers"].values():
        assert layer["valid"]
        assert not layer["crs_valid"]
        assert layer["extent"] == pytest.approx([330_000, 2_040_000, 330_060, 2_040_045])
    assert 329_900 < project["extent"][0] < 330_000
    assert project["colours"] > 100


def legend(names, colours):
    return [[name, "#{:02x}{:02x}{:02x}".format(*colours[code])] for code, name in enumerate(names)]


def test_a_comparison_shows_its_kinds_as_pixels_and_places(tmp_path):
    later = survey(3, rut=0.1, c_r=3.0)
    later.c_r[600:] = np.nan  # the ride over the end of the rut is not known
    before, after = write_folder(tmp_path / "may", survey(1)), write_folder(tmp_path / "june", later)
    change = bumpymap.diff_surveys(before, after, tmp_path / "out")
    layers = load(change.folder)["layers"]
    raster, places = layers["change.tif"], layers["change.geojson"]
    assert (raster["renderer"], raster["bands"], raster["crs"]) == ("paletted", [6], "EPSG:32614")
    assert raster["values"] == [0, 1, 2, 3, 4]
    assert raster["legend"] == [[*entry, 255] for entry in legend(CHANGE_KINDS, CHANGE_COLOURS)]
    assert raster["colours"] >= 3  # unchanged ground, and more than one kind of change
    assert places["renderer"] == "categorizedSymbol"
    assert [entry[:2] for entry in places["legend"]] == legend(CHANGE_KINDS, CHANGE_COLOURS)[1:]
    assert places["drawn"] == Counter(about["kind"] for about in change.field.regions)
    assert places["features"] == len(change.field.regions) > 0


def test_stretches_are_drawn_by_how_far_the_map_is_off(tmp_path):
    result = made_up_check(60, noise=0.4, unknown=[4])
    write_check(result, tmp_path / "out", ground=MadeUpMap.around())
    layer = load(tmp_path / "out")["layers"]["check.geojson"]
    assert layer["renderer"] == "categorizedSymbol"
    assert [entry[:2] for entry in layer["legend"]] == legend(OFF_KINDS, OFF_COLOURS)
    assert layer["drawn"] == Counter(OFF_KINDS[kind] for kind in MapOffset.of(result.stretches).kind.tolist())
    assert layer["features"] == 60
    assert layer["colours"] > 6
