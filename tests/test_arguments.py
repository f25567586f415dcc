"""Arguments of the calls: wrong ones are errors that name them, of any type."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from point_files import write_ply

import bumpymap
from bumpymap.change.pipeline import DiffSettings
from bumpymap.check.pipeline import CheckSettings
from bumpymap.route.pipeline import RouteSettings
from bumpymap.scan.classifier import ClassifierSettings
from bumpymap.survey import MapSettings

pytestmark = pytest.mark.usefixtures("without_views")

ROOT = Path(__file__).resolve().parents[1]
QUARRY = ROOT / "sample_data" / "quarry.laz"
GROUND = np.rec.fromarrays(np.random.default_rng(0).uniform(0, 30, (3, 5000)) * [[1], [1], [0.01]], names="x,y,z")
BAD = [
    ({"tile_size": -1}, "tile_size"),
    ({"tile_size": 4}, "tile_size=3"),
    ({"ground": "grass"}, "ground"),
    ({"ground": "csf", "csf": {"rigidness": 7}}, "rigidness"),
    ({"vehicle": "hovercraft"}, "hovercraft"),
    ({"calibration": "missing.json"}, "missing.json"),
    ({"model": "missing.onnx"}, "missing.onnx"),
    ({"crs": "EPSG:1"}, "crs='EPSG:1'"),
    ({"crs": "EPSG:4326"}, "CRS"),
    ({"memory": "lots"}, "memory"),
    ({"features": {"max_holes": 1}}, "max_holes"),
    ({"method": "sharp"}, "method"),
    ({"method": "filter", "model": "a.onnx"}, "`method` is filter"),
    ({"robot": {"radius": 1}}, "radius"),
    ({"polar": {"rings": "many"}}, "rings"),
]


@pytest.mark.parametrize(("settings", "words"), BAD)
def test_a_wrong_value_is_an_error_that_names_the_argument(settings, words):
    call = (
        bumpymap.ScanClassifier
        if {"method", "robot", "polar"} & set(settings)
        else partial(bumpymap.map_survey, QUARRY)
    )
    with pytest.raises(bumpymap.BumpymapError) as caught:
        call(**settings)
    assert words in " ".join([str(caught.value), *getattr(caught.value, "__notes__", [])])


ENDS = ("9.17,48.78", "9.18,48.78")
SETTINGS = {
    "map": (MapSettings, lambda **given: bumpymap.map_survey(QUARRY, **{"memory": "no size"} | given)),
    "route": (RouteSettings, lambda **given: bumpymap.find_routes("layers", *ENDS, **given)),
    "diff": (DiffSettings, lambda **given: bumpymap.diff_surveys("layers", "layers", **given)),
    "check": (CheckSettings, lambda **given: bumpymap.check_drives("layers", "drive.csv", **given)),
    "scan": (ClassifierSettings, lambda **given: bumpymap.classify_scan([[0.0, 0.0]], **given)),
}
"""The keywords of a call, and the call with them."""
CALLS = {
    "open": bumpymap.open,
    "Layers": bumpymap.Layers,
    "surveys": bumpymap.map_survey,
    "out": lambda value: bumpymap.map_survey(QUARRY, value, memory="no size"),
    "source": lambda value: bumpymap.map_batch(value, "out"),
    "out of a batch": lambda value: bumpymap.map_batch("sample_data", value, memory="no size"),
    "layers": lambda value: bumpymap.find_routes(value, *ENDS),
    "start": lambda value: bumpymap.find_routes("layers", value, ENDS[1]),
    "goal": lambda value: bumpymap.find_routes("layers", ENDS[0], value),
    "via": lambda value: bumpymap.find_routes("layers", *ENDS, via=value),
    "before": lambda value: bumpymap.diff_surveys(value, "layers"),
    "drives": lambda value: bumpymap.check_drives(None, value),
    "map of a check": lambda value: bumpymap.check_drives(value, "drive.csv"),
    "points": bumpymap.classify_scan,
    "points_of": bumpymap.points_of,
    "grid": lambda value: bumpymap.ScanClassifier(grid={"reach_m": value}),
    "vehicle": bumpymap.Vehicle.load,
    "calibration": bumpymap.Calibration.load,
    "shipped": bumpymap.Calibration.shipped,
}
CALLS |= {
    f"{kind}, {name}": lambda value, name=name, call=call: call(**{name: value})
    for kind, (settings, call) in SETTINGS.items()
    for name in settings.__annotations__
}
"""A value of an argument -> a call with it, in which something else is wrong too if some value of any type is right."""
ODD = [None, 3, 2.5, [1], np.zeros((3, 2)), {"a": 1}, b"a", object(), Path("/nowhere/a"), "", "a\0b", "a" * 5000]


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
def test_an_argument_of_any_type_is_no_error_from_the_inside(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for value in ODD:
        try:
            call(value)
        except bumpymap.BumpymapError as error:
            assert str(error)  # noqa: PT017 (some values are right)


@pytest.mark.parametrize(
    ("call", "name", "meant"),
    [
        (SETTINGS["map"][1], "tilesize", "tile_size"),
        (lambda **settings: bumpymap.map_batch("a", "b", **settings), "jbos", "jobs"),
        (SETTINGS["route"][1], "riks", "risk"),
        (SETTINGS["diff"][1], "min_tile", "min_tiles"),
        (SETTINGS["check"][1], "band", "band_hz"),
        (SETTINGS["scan"][1], "polr", "polar"),
    ],
)
def test_a_setting_that_is_not_there_is_a_usage_error_with_the_nearest_name(call, name, meant):
    with pytest.raises(bumpymap.UsageError, match=rf"unknown setting {name}; there are: .*\. Did you mean {meant}\?"):
        call(**{name: 1})


@pytest.mark.parametrize("crs", [32632, np.int64(32632)])
def test_a_crs_may_be_its_number(tmp_path, crs):
    survey = write_ply(tmp_path / "site.ply", GROUND)
    assert bumpymap.map_survey(survey, crs=crs).manifest["crs"]["code"] == "EPSG:32632"


def test_a_vehicle_that_is_no_file_leads_to_the_included_calibrations():
    with pytest.raises(bumpymap.BadInputError, match=r"Calibration\.shipped\('warthog'\)"):
        bumpymap.Calibration.load("warthog")


@pytest.mark.parametrize(
    ("before", "settings", "said"),
    [
        ("complete", {"local": True, "ground": "all"}, "overwrite=True"),
        ("other", {"local": True}, "overwrite=True"),
        ("file", {"local": True}, ""),
        ("", {}, "local=True"),  # no CRS
        ("", {"local": True, "ground": "class"}, "ground='all'"),
        ("", {"local": True, "ground": "class", "memory": "nothing"}, ""),
    ],
)
def test_what_inputs_and_folders_cause_says_what_to_pass(before, settings, said, tmp_path):
    out, survey = tmp_path / "out", write_ply(tmp_path / "site.ply", GROUND)
    if before == "complete":
        bumpymap.map_survey(survey, out, local=True)
    elif before == "other":
        (out / "rasters").mkdir(parents=True)
        (out / "rasters/class.tif").touch()
    elif before == "file":
        out.touch()
    with pytest.raises(bumpymap.BumpymapError) as caught:
        bumpymap.map_survey(survey, out, **settings)
    assert said in str(caught.value)
