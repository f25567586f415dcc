"""What QGIS makes of the layers of a check when they are dragged in."""

import json
import subprocess
from collections import Counter
from pathlib import Path

import pytest
from check_records import made_up_check
from route_records import MadeUpMap

from bumpymap.check.pipeline import write_check
from bumpymap.layers.check_vectors import OFF_KINDS, MapOffset
from bumpymap.layers.colours import OFF_COLOURS

SCRIPT = Path(__file__).with_name("load_in_qgis.py")
LEGEND = [[name, "#{:02x}{:02x}{:02x}".format(*OFF_COLOURS[code])] for code, name in enumerate(OFF_KINDS)]


@pytest.fixture(name="seen", scope="module")
def seen_fixture(tmp_path_factory):
    root = tmp_path_factory.mktemp("check")
    result = made_up_check(60, noise=0.4, unknown=[4])
    write_check(result, root / "out", ground=MadeUpMap.around())
    command = ["/usr/bin/python3", str(SCRIPT), str(root / "out"), str(root / "seen.json"), str(root / "pictures")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads((root / "seen.json").read_text(encoding="utf-8"))["layers"], result


@pytest.mark.qgis
def test_stretches_are_drawn_by_how_far_the_map_is_off(seen):
    layers, result = seen
    layer = layers["check.geojson"]
    assert layer["renderer"] == "categorizedSymbol"
    assert [entry[:2] for entry in layer["legend"]] == LEGEND
    assert layer["drawn"] == Counter(OFF_KINDS[kind] for kind in MapOffset.of(result.stretches).kind.tolist())
    assert layer["features"] == 60
    assert layer["colours"] > 6


def test_what_errors_do_not_explain_is_larger(tmp_path):
    result = made_up_check(12, noise=0.4)
    write_check(result, tmp_path / "out", ground=MadeUpMap.around())
    style = (tmp_path / "out" / "check.qml").read_text()
    assert style.count("if(&quot;explained&quot; = false, 4.2, 2.6)") == len(OFF_KINDS)
    features = json.loads((tmp_path / "out" / "check.geojson").read_text())["features"]
    explained = [feature["properties"]["explained"] for feature in features]
    assert explained == (~MapOffset.of(result.stretches).is_off).tolist()
    assert len(set(explained)) == 2
