import json

import pytest

from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.rating.calibration import Calibration, shipped_calibrations


@pytest.fixture
def record():
    return json.loads(Calibration.shipped("warthog").to_json())


def test_a_calibration_survives_its_file(record, tmp_path):
    shipped = Calibration.shipped("warthog")
    (tmp_path / "c.json").write_text(shipped.to_json())
    assert Calibration.load(tmp_path / "c.json") == shipped
    assert Calibration.load(tmp_path / "c.json").id == shipped.id == record["id"]


def test_the_id_changes_with_any_number(record):
    ids = {record["id"]}
    for change in ({"tile_size": 2.5}, {"ride": {"c_r": [1.0]}}, {"ride": {"c_r": [1.5]}}, {"ride": None}):
        ids.add(Calibration.from_json(json.dumps(record | change), "c.json").id)
    record["p_fail"][0][0] += 0.001
    ids.add(Calibration.from_json(json.dumps(record), "c.json").id)
    assert len(ids) == 6


def test_a_file_without_steps_keeps_its_id(record):
    """Files of earlier versions have no such key."""
    del record["steps"]
    bare = Calibration.from_json(json.dumps(record), "c.json")
    assert bare.steps is None
    assert "steps" not in json.loads(bare.to_json())
    assert bare.id != record["id"]
    assert Calibration.from_json(bare.to_json(), "c.json").id == bare.id


@pytest.mark.parametrize("name", shipped_calibrations())
def test_every_shipped_calibration_knows_its_vehicle_and_has_a_ride_model(name):
    shipped = Calibration.shipped(name)
    assert shipped.vehicle["name"] == name
    library = shipped.settings["library"]
    drives = sum(sum(columns[name]) for columns in library.values() for name in ("completed", "stuck", "rolled"))
    # The paper drove 2,478 times.
    assert sum(map(sum, shipped.drives)) + drives >= 2478
    assert shipped.ride is not None
    assert shipped.ride["origin"]["drives"] == drives
    assert shipped.steps is not None
    assert len(shipped.steps["crossing"]["fail_up"]) == len(shipped.steps["crossing"]["height"])
    assert 0 < shipped.class_c_r[0] < shipped.class_limits[0] < shipped.class_c_r[1] < shipped.class_limits[1]
    assert shipped.class_limits[1] < shipped.class_c_r[2] < shipped.class_limits[2] < shipped.class_c_r[3]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ({"format": "other"}, "is not a bumpymap calibration"),
        ({"version": 99}, "version 99"),
        ({"version": 1}, "version 1; this bumpymap reads version 2. Make one with: bumpymap calibrate --vehicle"),
        ({"ride": ...}, "damaged calibration: KeyError"),
        ({"ride": [1.0]}, "damaged"),
        ({"ride": {"c_r": [float("inf")]}}, "damaged"),
        ({"motion": {"map_speed_mps": 0.0}}, "damaged"),
        ({"motion": 2.0}, "damaged"),
        ({"vehicle": {}}, "damaged"),
        ({"z_range": []}, "damaged"),
        ({"class_limits": [0.1, 0.2]}, "damaged"),
        ({"class_c_r": [0.1, 0.2, 0.3, None]}, "damaged"),
        ({"c_r": [["a"] * 14] * 4}, "damaged"),
        ({"c_r": [[0.0] * 14] * 4}, "damaged"),
        ({"c_r": [[None] + [0.1] * 13] * 4}, "damaged"),
        ({"p_fail": [[float("nan")] * 14] * 4}, "damaged"),
        ({"p_fail": [[0.0] * 13] * 4}, "damaged"),
        ({"textures": ["a", "b", "c", "d"]}, "damaged"),
    ],
)
def test_damage_is_named_before_anything_is_rated(record, damage, message):
    with pytest.raises(BadInputError, match=message):
        Calibration.from_json(json.dumps({k: v for k, v in (record | damage).items() if v is not ...}), "c.json")


@pytest.mark.parametrize("content", [b"", b"hello", b"\x9a\x00\xff", b"[]", b"3"])
def test_another_file_is_no_calibration(tmp_path, content):
    (tmp_path / "c.json").write_bytes(content)
    with pytest.raises(BadInputError, match="is not a bumpymap calibration"):
        Calibration.load(tmp_path / "c.json")


def test_unknown_names_list_the_known_ones():
    with pytest.raises(UsageError, match=r"available are: .*warthog"):
        Calibration.shipped("bicycle")
