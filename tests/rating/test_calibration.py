"""Calibrations: their files and ids, those that are shipped, and the one that belongs to a vehicle."""

import json
import math
from pathlib import Path

import pytest

from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.rating import Calibration, find_calibration, map_calibration, shipped_calibrations

VEHICLE = Calibration.shipped("warthog").vehicle
DATA = Path(__file__).parents[2] / "bumpymap" / "rating" / "data"


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
    for change in ({"tile_size": 2.5}, {"ride": {"c_r": [1.0]}}, {"ride": {"c_r": [1.5]}}):
        ids.add(Calibration.from_json(json.dumps(record | change), "c.json").id)
    record["p_fail"][0][0] += 0.001
    ids.add(Calibration.from_json(json.dumps(record), "c.json").id)
    assert len(ids) == 5


@pytest.mark.parametrize("name", shipped_calibrations())
def test_every_shipped_calibration_knows_its_vehicle_and_has_a_ride_model(name):
    shipped = Calibration.shipped(name)
    assert shipped.vehicle["name"] == name
    library = shipped.settings["library"]
    drives = sum(sum(columns[name]) for columns in library.values() for name in ("completed", "stuck", "rolled"))
    # The paper drove 2,478 times.
    assert sum(map(sum, shipped.drives)) + drives >= 2478
    assert shipped.ride["origin"]["drives"] == drives
    assert len(shipped.steps["crossing"]["fail_up"]) == len(shipped.steps["crossing"]["height"])
    limits = [0, *shipped.class_limits, math.inf]
    assert all(low < c_r < high for low, c_r, high in zip(limits, shipped.class_c_r, limits[1:], strict=False))
    rule = shipped.cost_rule
    assert rule.drive_m == shipped.vehicle["speed_mps"] * shipped.settings["drive"]["measure_s"]
    assert (rule.ride_weight, rule.fail_weight) == (shipped.vehicle["ride_weight"], 300.0)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ({"format": "other"}, "is not a bumpymap calibration"),
        ({"version": 1}, "version 1; this bumpymap reads version 2. Make one with: bumpymap calibrate --vehicle"),
        *(({name: ...}, "damaged calibration: KeyError") for name in ("ride", "thin", "steps", "motion")),
        ({"ride": {"c_r": [float("inf")]}}, "damaged"),
        ({"motion": {"map_speed_mps": 0.0}}, "motion.map_speed_mps is '0.0'"),
        ({"vehicle": {}}, "c.json, vehicle: .* errors"),
        *(({"vehicle": VEHICLE | wrong}, "c.json, vehicle") for wrong in ({"fail_weight": -1.0}, {"speed_mps": 0.0})),
        *(
            ({"vehicle": VEHICLE | {"floor": {"c_r_radpm": wrong}}}, "c.json, vehicle: floor.c_r_radpm is")
            for wrong in (-0.1, "much", math.nan)
        ),
        ({"class_limits": [0.1, 0.2]}, "class_limits is .* it must be an array of 3"),
        ({"class_limits": [0.1, 0.3, 0.2]}, "class_limits must be increasing"),
        ({"class_c_r": [0.1, 0.2, 0.3, None]}, "class_c_r.3 is 'None'; it must be a number"),
        ({"c_r": [[None] + [0.1] * 13] * 4}, "known at the lowest z range"),
        ({"p_fail": [[float("nan")] * 14] * 4}, "p_fail.0.0 is 'nan'; it must be a number from 0 to 1"),
        ({"textures": ["a", "b", "c", "d"]}, "damaged"),
    ],
)
def test_damage_is_named_before_anything_is_rated(record, damage, message):
    with pytest.raises(BadInputError, match=message):
        Calibration.from_json(json.dumps({k: v for k, v in (record | damage).items() if v is not ...}), "c.json")


@pytest.mark.parametrize("content", [b"", b"hello", b"\x9a\x00\xff", b"[]"])
def test_another_file_is_no_calibration(tmp_path, content):
    (tmp_path / "c.json").write_bytes(content)
    with pytest.raises(BadInputError, match="is not a bumpymap calibration"):
        Calibration.load(tmp_path / "c.json")


@pytest.fixture
def mine(tmp_path):
    """Return the car's profile and calibration, as files of one's own."""
    (tmp_path / "mine.json").write_bytes((DATA / "calibrations" / "car.json").read_bytes())
    path = tmp_path / "mine.toml"
    path.write_bytes((DATA / "vehicles" / "car.toml").read_bytes())
    return path


def change(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_preferences_and_the_outline_are_those_of_the_profile(mine):
    car = Calibration.shipped("car")
    assert find_calibration(mine) == find_calibration("car") == car
    change(mine, "fail_weight = 300.0\n", "")
    assert find_calibration(str(mine)).id == car.id
    assert "body" not in car.vehicle
    assert (car.body.height_m, car.body.lowest_obstacle_m) == (1.84, 0.24)
    change(mine, "ride_weight = 5.0", "ride_weight = 2\nfail_weight = 40")
    change(mine, 'name = "car"', 'name = "mine"')
    told = {"name": "mine", "description": car.vehicle["description"], "ride_weight": 2.0, "fail_weight": 40.0}
    weighed = find_calibration(mine)
    assert weighed.preferences == told
    change(mine, "height_m = 1.84", "height_m = 2.1")
    change(mine, "[belly]", "[comfort]\na_w_mps2 = 0.8\n\n[belly]")
    found = find_calibration(mine)
    assert found.vehicle["comfort"] == {"pitch_rate_radps": 0.3, "a_w_mps2": 0.8, "top_speed_mps": 0.0}
    assert (found.body.height_m, found.body.width_m) == (2.1, 1.84)
    assert (found.c_r, found.ride) == (car.c_r, car.ride)
    assert len({found.id, weighed.id, car.id}) == 3
    made = {"vehicle": {"name": "mine"}, "calibration": {"id": found.id, "preferences": found.preferences}}
    assert map_calibration(made, 3.0) == found  # of a map that somebody else made, without its TOML file
    made["calibration"]["preferences"] = {"comfort": [1.0]}
    with pytest.raises(UsageError, match="is not found"):
        map_calibration(made, 3.0)


def test_another_vehicle_is_refused_with_what_differs(mine):
    change(mine, "wheelbase_m = 2.7", "wheelbase_m = 2.8")
    change(mine, "clearance_m = 0.24", "clearance_m = 0.2")
    change(mine, "ride_weight = 5.0", "ride_weight = 2")
    with pytest.raises(BadInputError) as caught:
        find_calibration(mine)
    beside = mine.with_suffix(".json")
    assert str(caught.value) == (
        f"{beside} was made for another vehicle: wheelbase_m is 2.8, was 2.7; belly.clearance_m is 0.2, was 0.24. "
        f"Calibrate for the vehicle of {mine}: bumpymap calibrate --vehicle {mine} --out {beside} --overwrite"
    )


def test_without_a_calibration_the_command_that_makes_it_is_said(mine):
    mine.with_suffix(".json").unlink()
    assert find_calibration(mine) == Calibration.shipped("car")  # the vehicle that ships, under another name
    change(mine, "wheelbase_m = 2.7", "wheelbase_m = 2.8")
    with pytest.raises(BadInputError, match=rf"bumpymap calibrate --vehicle {mine} --out {mine.with_suffix('.json')} "):
        find_calibration(mine)
