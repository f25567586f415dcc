"""What QGIS makes of the files of a comparison when they are dragged in."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from route_maps import write_folder
from survey_pairs import survey

import bumpymap
from bumpymap.core import CHANGE_KINDS
from bumpymap.layers.colours import CHANGE_COLOURS

SCRIPT = Path(__file__).with_name("load_in_qgis.py")
HEX = ["#{:02x}{:02x}{:02x}".format(*CHANGE_COLOURS[code]) for code in range(len(CHANGE_KINDS))]


@pytest.fixture(name="seen", scope="module")
def seen_fixture(tmp_path_factory):
    root = tmp_path_factory.mktemp("change")
    later = survey(3, rut=0.1, c_r=3.0)
    later.c_r[600:] = np.nan  # the ride over the end of the rut is not known
    before, after = write_folder(root / "may", survey(1)), write_folder(root / "june", later)
    change = bumpymap.diff_surveys(before, after, root / "out")
    report = root / "seen.json"
    command = ["/usr/bin/python3", str(SCRIPT), str(change.folder), str(report)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(report.read_text(encoding="utf-8"))["layers"], change


@pytest.mark.qgis
def test_the_raster_shows_exactly_its_kinds(seen):
    raster = seen[0]["change.tif"]
    assert raster["renderer"] == "paletted"
    assert raster["bands"] == [6]
    assert raster["values"] == [0, 1, 2, 3, 4]
    assert raster["legend"] == [[name, colour, 255] for name, colour in zip(CHANGE_KINDS, HEX, strict=True)]
    assert raster["crs"] == "EPSG:32614"
    assert raster["colours"] >= 3  # unchanged ground, and more than one kind of change


@pytest.mark.qgis
def test_every_place_is_drawn_by_what_became_of_its_ride(seen):
    layers, change = seen
    places = layers["change.geojson"]
    assert places["renderer"] == "categorizedSymbol"
    assert [entry[:2] for entry in places["legend"]] == [
        list(pair) for pair in zip(CHANGE_KINDS[1:], HEX[1:], strict=True)
    ]
    kinds = [about["kind"] for about in change.field.regions]
    assert places["drawn"] == {kind: kinds.count(kind) for kind in set(kinds)}
    assert places["features"] == len(kinds) > 0
