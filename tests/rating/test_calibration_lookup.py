from pathlib import Path

import pytest

from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.vehicle_profile import find_calibration

DATA = Path(__file__).parents[2] / "bumpymap" / "rating" / "data"


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


def test_equal_preferences_leave_the_id_alone(mine):
    assert find_calibration(mine) == Calibration.shipped("car")
    change(mine, "fail_weight = 300.0\n", "")
    assert find_calibration(str(mine)).id == Calibration.shipped("car").id


def test_preferences_are_those_of_the_profile(mine):
    change(mine, "fail_weight = 300.0", "fail_weight = 40")
    change(mine, "ride_weight = 5.0", "ride_weight = 2")
    change(mine, 'name = "car"', 'name = "mine"')
    found, car = find_calibration(mine), Calibration.shipped("car")
    assert found.preferences == {
        "name": "mine", "description": car.vehicle["description"], "ride_weight": 2.0, "fail_weight": 40.0
    }  # fmt: skip
    assert (found.c_r, found.ride) == (car.c_r, car.ride)
    assert found.id != car.id


def test_the_outline_is_a_preference_too(mine):
    car = Calibration.shipped("car")
    assert "body" not in car.vehicle
    assert (car.body.height_m, car.body.lowest_obstacle_m) == (1.84, 0.24)
    change(mine, "height_m = 1.84", "height_m = 2.1")
    found = find_calibration(mine)
    assert (found.body.height_m, found.body.width_m) == (2.1, 1.84)
    assert (found.ride, found.id != car.id) == (car.ride, True)


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


def test_neither_name_nor_file(tmp_path):
    for vehicle in ("tank", str(tmp_path / "none.toml")):
        with pytest.raises(UsageError, match=r"no vehicle .*\(car, husky, small_rover, warthog\)"):
            find_calibration(vehicle)
    with pytest.raises(BadInputError, match="cannot read the calibration"):
        find_calibration("warthog", tmp_path / "none.json")
