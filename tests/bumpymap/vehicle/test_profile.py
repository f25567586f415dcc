import dataclasses
import json
import re
from pathlib import Path

import pytest

from bumpymap.errors import BadInputError
from bumpymap.vehicle.profile import VehicleProfile, load_profile, shipped_profiles


@pytest.fixture
def warthog():
    return load_profile("warthog").to_dict()


def test_three_profiles_ship_and_carry_their_own_names():
    assert shipped_profiles() == ["car", "small_rover", "warthog"]
    for name in shipped_profiles():
        assert load_profile(name).name == name


def test_masses_add_up_to_what_the_descriptions_say():
    assert load_profile("warthog").mass_kg == 260
    assert load_profile("small_rover").mass_kg == 20
    assert load_profile("car").mass_kg == 1900


def test_dictionary_is_its_own_json_and_builds_the_same_profile(warthog):
    assert json.loads(json.dumps(warthog)) == warthog
    assert VehicleProfile.from_dict(warthog, "x") == load_profile("warthog")


def test_ride_weight_and_slope_limit_are_on_top_where_map_reads_them(warthog):
    assert warthog["ride_weight"] > 0
    assert 0 < warthog["slope_limit_deg"] <= 60


def test_profile_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        load_profile("warthog").speed_mps = 3


def test_file_with_a_path_is_read(tmp_path):
    source = Path(__file__).parents[3] / "bumpymap" / "data" / "vehicles" / "car.toml"
    path = tmp_path / "mine.toml"
    path.write_text(source.read_text().replace("speed_mps = 3.0", "speed_mps = 2"))
    assert load_profile(path).speed_mps == 2.0
    assert isinstance(load_profile(str(path)).speed_mps, float)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("wheelbase_m", -1, ["wheelbase_m is -1", "> 0"]),
        ("wheelbase_m", "long", ["'long'", "finite number"]),
        ("wheelbase_m", True, ["True", "finite number"]),
        ("wheelbase_m", float("nan"), ["nan", "finite number"]),
        ("wheelbase_m", 0.6, ["touch", "twice the radius"]),
        ("track_m", 0.2, ["track_m 0.2", "wheel width"]),
        ("speed_mps", 0, ["speed_mps is 0", "> 0 and <= 15"]),
        ("speed_mps", 16, ["speed_mps is 16", "<= 15"]),
        ("slope_limit_deg", 90, ["slope_limit_deg is 90", "<= 60"]),
        ("ride_weight", -0.1, ["ride_weight is -0.1", ">= 0"]),
        ("name", " ", ["name is ' '", "not empty"]),
        ("chassis", 3, ["chassis is 3", "table"]),
        ("chassis.mass_kg", 0, ["chassis.mass_kg is 0", "> 0"]),
        ("chassis.com_height_m", -0.31, ["com_height_m", "below the ground"]),
        ("chassis.inertia_kgm2", [1.0, 1.0], ["three numbers"]),
        ("chassis.inertia_kgm2", [1.0, 1.0, 2.1], ["sum of the two others"]),
        ("chassis.inertia_kgm2", [1.0, 1.0, 0.0], ["> 0"]),
        ("rocker.limit_rad", 2, ["rocker.limit_rad is 2", "<= 1.2"]),
        ("rocker.damping_nms_per_rad", -1, ["rocker.damping_nms_per_rad is -1", ">= 0"]),
        ("wheel.radius_m", float("inf"), ["wheel.radius_m is inf", "finite"]),
        ("belly.clearance_m", 0, ["belly.clearance_m is 0", "> 0"]),
        ("belly.width_m", 0.9, ["belly.width_m is 0.9", "0.87 apart", "fit between"]),
    ],
)
def test_value_that_cannot_be_is_refused_with_what_came_and_what_is_allowed(warthog, key, value, words):
    *table, name = key.split(".")
    (warthog[table[0]] if table else warthog)[name] = value
    with pytest.raises(BadInputError) as caught:
        VehicleProfile.from_dict(warthog, "my.toml")
    for word in ["my.toml", *words]:
        assert word in str(caught.value)


def test_borders_of_ranges_are_allowed(warthog):
    warthog["ride_weight"] = 0
    warthog["rocker"].update(stiffness_nm_per_rad=0, damping_nms_per_rad=0, limit_rad=0)
    assert VehicleProfile.from_dict(warthog, "x").rocker.limit_rad == 0


def test_body_above_the_wheels_may_be_wider_than_the_way_between_them(warthog):
    warthog["belly"].update(width_m=1.4, clearance_m=0.6)
    assert VehicleProfile.from_dict(warthog, "x").belly.width_m == 1.4


def test_unknown_key_is_refused_and_the_known_ones_named(warthog):
    warthog["wheel"]["radius"] = 0.3
    with pytest.raises(BadInputError, match=r"unknown radius in \[wheel\]; allowed: mass_kg, radius_m, width_m"):
        VehicleProfile.from_dict(warthog, "my.toml")


def test_missing_key_is_refused(warthog):
    del warthog["track_m"], warthog["belly"]
    with pytest.raises(BadInputError, match="missing track_m, belly"):
        VehicleProfile.from_dict(warthog, "my.toml")


def test_unknown_name_lists_the_shipped_profiles():
    with pytest.raises(BadInputError, match=re.escape("car, small_rover, warthog")):
        load_profile("tank")


def test_text_that_is_not_toml_is_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("name = ")
    with pytest.raises(BadInputError, match="not a TOML file"):
        load_profile(path)


def test_bytes_and_folders_are_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes(b"\xff\xfe\x00")
    for place in (path, tmp_path):
        with pytest.raises(BadInputError, match="cannot read the vehicle profile"):
            load_profile(place)


def test_the_docs_name_every_key_and_tell_the_shipped_values():
    page = (Path(__file__).parents[3] / "docs" / "pages" / "vehicle-profile.md").read_text()
    schema, shipped = page.split("## The three that ship")
    rows = {}
    for line in shipped.splitlines():
        if line.startswith("| `"):
            key, *values = [cell.strip(" `") for cell in line.strip("|").split("|")]
            rows[key] = values
    profiles = [load_profile(name).to_dict() for name in ("warthog", "small_rover", "car")]
    flat = [
        {f"{k}.{kk}": vv for k, v in p.items() if isinstance(v, dict) for kk, vv in v.items()}
        | {k: v for k, v in p.items() if not isinstance(v, dict) and k not in {"name", "description"}}
        for p in profiles
    ]
    assert set(rows) == set(flat[0])
    for key, values in rows.items():
        assert f"| `{key}` |" in schema
        for text, profile in zip(values, flat, strict=True):
            numbers = profile[key] if isinstance(profile[key], list) else [profile[key]]
            assert [float(number) for number in text.split(",")] == numbers
