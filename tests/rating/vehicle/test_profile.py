import dataclasses
import json
import re
from pathlib import Path

import pytest

from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.rating.vehicle_profile import KEYS, Vehicle, load_profile, shipped_profiles


@pytest.fixture
def warthog():
    return load_profile("warthog").to_dict()


def test_four_profiles_ship_and_carry_their_own_names():
    assert shipped_profiles() == ["car", "husky", "small_rover", "warthog"]
    for name in shipped_profiles():
        assert load_profile(name).name == name


def test_masses_add_up_to_what_the_descriptions_say():
    assert load_profile("warthog").mass_kg == 260
    assert load_profile("small_rover").mass_kg == 20
    assert load_profile("car").mass_kg == 1900
    assert load_profile("husky").mass_kg == pytest.approx(56.5, abs=0.1)


def test_dictionary_is_its_own_json_and_builds_the_same_profile(warthog):
    assert json.loads(json.dumps(warthog)) == warthog
    assert Vehicle.from_dict(warthog, "x") == load_profile("warthog")


def test_ride_weight_and_slope_limit_are_on_top_where_map_reads_them(warthog):
    assert warthog["ride_weight"] > 0
    assert 0 < warthog["slope_limit_deg"] <= 60


def test_profile_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        load_profile("warthog").speed_mps = 3


def test_file_with_a_path_is_read(tmp_path):
    source = Path(__file__).parents[3] / "bumpymap" / "rating" / "data" / "vehicles" / "car.toml"
    path = tmp_path / "mine.toml"
    path.write_text(source.read_text().replace("speed_mps = 3.0", "speed_mps = 2"))
    assert load_profile(path).speed_mps == 2.0
    assert isinstance(load_profile(str(path)).speed_mps, float)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("wheelbase_m", 920, ["wheelbase_m is 920; it must be between 0.1 and 20 metres; 920 mm would be 0.92"]),
        ("wheelbase_m", "long", ["wheelbase_m is 'long'; it must be between"]),
        ("wheelbase_m", "?", ["wheelbase_m is not filled in: between 0.1 and 20 metres"]),
        ("wheelbase_m", float("nan"), ["wheelbase_m is nan; it must be between"]),
        ("wheelbase_m", 10**400, ["wheelbase_m is 1000", "metres"]),
        ("wheelbase_m", 0.6, ["touch", "twice the radius"]),
        ("track_m", 0.2, ["track_m 0.2", "wheel width"]),
        ("speed_mps", 0, ["speed_mps is 0; it must be between 0.05 and 15 metres per second"]),
        ("speed_mps", 36, ["speed_mps is 36; it must be between", "36 km/h would be 10"]),
        ("name", " ", ["name is ' '", "not empty"]),
        ("description", "a\x1b[31m\n", [r"description is 'a\x1b[31m\n'", "one line"]),
        ("chassis", 3, ["chassis is 3", "table, [chassis], with mass_kg, inertia_kgm2, com_height_m"]),
        ("chassis.mass_kg", 0, ["chassis.mass_kg is 0; it must be between 0.2 and 1,000,000 kilograms"]),
        ("chassis.mass_kg", 100_000, ["100,160 kg", "between", "masses in kilograms"]),
        ("chassis.com_height_m", -0.31, ["com_height_m", "below the ground"]),
        ("chassis.inertia_kgm2", [1.0, 1.0], ["three numbers, [roll, pitch, yaw]"]),
        ("chassis.inertia_kgm2", [6.0, 6.0, 12.1], ["sum of the two others"]),
        ("chassis.inertia_kgm2", [542.0, 1333.0, 1608.0], ["chassis.inertia_kgm2 is [542.0, 1333.0, 1608.0]", "box"]),
        ("rocker.inertia_kgm2", [5.4e-6, 5.42e-5, 5.21e-5], ["rocker.inertia_kgm2", "each moment lies between"]),
        ("rocker.limit_rad", 8, ["rocker.limit_rad is 8; it must be between 0 and 1.2 radians; 8 deg would be 0.14"]),
        ("belly.width_m", 0.9, ["belly.width_m is 0.9", "0.87 apart", "fit between"]),
        ("belly.length_m", 13, ["belly.length_m is 13", "4 times"]),
        ("body.height_m", 0.5, ["body.height_m is 0.5", "reach up to 0.6"]),
        ("body.width_m", 1.2, ["body.width_m is 1.2", "1.37 wide"]),
        ("body.brush_stem_m", 1.4, ["body.height_m is 1.38 and body.brush_stem_m 1.4"]),
    ],
)
def test_value_that_cannot_be_is_refused_with_what_came_and_what_is_allowed(warthog, key, value, words):
    *table, name = key.split(".")
    (warthog[table[0]] if table else warthog)[name] = value
    with pytest.raises(BadInputError) as caught:
        Vehicle.from_dict(warthog, "my.toml")
    for word in ["my.toml", *words]:
        assert word in str(caught.value)


def test_borders_of_ranges_are_allowed(warthog):
    warthog["ride_weight"] = 0
    warthog["rocker"].update(stiffness_nm_per_rad=0, damping_nms_per_rad=0, limit_rad=0)
    assert Vehicle.from_dict(warthog, "x").rocker.limit_rad == 0


def test_body_above_the_wheels_may_be_wider_than_the_way_between_them(warthog):
    warthog["belly"].update(width_m=1.4, clearance_m=0.6)
    del warthog["body"]
    assert Vehicle.from_dict(warthog, "x").belly.width_m == 1.4


def test_unknown_key_is_refused_and_the_known_ones_named(warthog):
    warthog["wheel"]["radius"] = 0.3
    with pytest.raises(
        BadInputError, match=r"\[wheel\]: unknown setting radius; there are: mass_kg, radius_m, width_m"
    ):
        Vehicle.from_dict(warthog, "my.toml")


def test_missing_keys_are_refused_and_a_table_is_said_to_be_one(warthog):
    del warthog["track_m"], warthog["belly"]
    with pytest.raises(BadInputError) as caught:
        Vehicle.from_dict(warthog, "my.toml")
    assert "missing track_m: between 0.05 and 15 metres" in str(caught.value)
    assert "missing belly: a table, [belly], with length_m, width_m, clearance_m" in str(caught.value)


def test_all_faults_are_said_at_once(warthog):
    warthog |= {"wheelbase_m": 920, "slope_limit_deg": 0.52, "colour": "red"}
    del warthog["wheel"]["radius_m"]
    with pytest.raises(BadInputError) as caught:
        Vehicle.from_dict(warthog, "my.toml")
    first, *faults = caught.value.args
    assert first.startswith("my.toml: 4 errors")
    assert [fault.split()[0] for fault in faults] == ["unknown", "wheelbase_m", "slope_limit_deg", "missing"]


HAUL_TRUCK = {
    "name": "haul_truck", "description": "Haul truck, 90 t payload, loaded", "wheelbase_m": 4.8, "track_m": 4.2,
    "speed_mps": 8, "slope_limit_deg": 15, "ride_weight": 5,
    "chassis": {"mass_kg": 140_000, "inertia_kgm2": [500_000, 1_200_000, 1_300_000], "com_height_m": 1.8},
    "belly": {"length_m": 9.5, "width_m": 2.5, "clearance_m": 0.8},
    "rocker": {"mass_kg": 2000, "inertia_kgm2": [100, 4000, 4000], "limit_rad": 0.1, "stiffness_nm_per_rad": 1e7,
               "damping_nms_per_rad": 1e6},
    "wheel": {"mass_kg": 2500, "radius_m": 1.35, "width_m": 0.85},
}  # fmt: skip
ROVER_2_KG = {
    "name": "rover", "description": "Rover of 2 kg", "wheelbase_m": 0.16, "track_m": 0.18, "speed_mps": 0.3,
    "slope_limit_deg": 15, "ride_weight": 5,
    "chassis": {"mass_kg": 1.3, "inertia_kgm2": [0.002, 0.004, 0.005], "com_height_m": 0.01},
    "belly": {"length_m": 0.2, "width_m": 0.1, "clearance_m": 0.03},
    "rocker": {"mass_kg": 0.05, "inertia_kgm2": [0.00001, 0.0002, 0.0002], "limit_rad": 0.3,
               "stiffness_nm_per_rad": 0, "damping_nms_per_rad": 0.1},
    "wheel": {"mass_kg": 0.15, "radius_m": 0.045, "width_m": 0.03},
}  # fmt: skip


@pytest.mark.parametrize("profile", [HAUL_TRUCK, ROVER_2_KG], ids=lambda profile: profile["name"])
def test_real_vehicles_far_apart_in_size_pass(profile):
    assert Vehicle.from_dict(profile, "x").name == profile["name"]


def test_fail_weight_may_be_left_out(warthog):
    del warthog["fail_weight"]
    assert Vehicle.from_dict(warthog, "x") == load_profile("warthog")
    assert Vehicle.from_dict(warthog | {"fail_weight": 40}, "x").fail_weight == 40.0


def test_an_outline_that_is_left_out_follows_from_wheels_and_belly(warthog):
    del warthog["body"]
    body = Vehicle.from_dict(warthog, "x").body
    assert (body.height_m, body.width_m, body.brush_stem_m) == (1.38, 1.37, 0.25)  # 2 * 0.3 + 0.7 * 1.12; 1.12 + 0.25
    given = Vehicle.from_dict(warthog | {"body": {"brush_stem_m": 0.6}}, "x").body
    assert (given.height_m, given.width_m, given.brush_stem_m) == (1.38, 1.37, 0.6)


def test_unknown_name_lists_the_shipped_profiles():
    with pytest.raises(UsageError, match=re.escape("car, husky, small_rover, warthog")):
        load_profile("tank")


def test_a_mark_of_byte_order_is_skipped(tmp_path):
    source = Path(__file__).parents[3] / "bumpymap" / "rating" / "data" / "vehicles" / "car.toml"
    path = tmp_path / "mine.toml"
    path.write_bytes(b"\xef\xbb\xbf" + source.read_bytes())
    assert load_profile(path) == load_profile("car")


def test_what_is_not_toml_is_refused(tmp_path):
    path = tmp_path / "mine.toml"
    for content in (b"name = ", b"\xff\xfe\x00"):
        path.write_bytes(content)
        with pytest.raises(BadInputError, match="cannot read the vehicle profile"):
            load_profile(path)
    with pytest.raises(BadInputError, match="it is not a file"):
        load_profile(tmp_path)


def test_the_docs_name_every_key_and_the_values_of_the_included_vehicles():
    page = (Path(__file__).parents[3] / "docs" / "pages" / "vehicle-profile.md").read_text()
    schema, shipped = page.split("## Values of the included vehicles")
    rows = {}
    for line in shipped.splitlines():
        if line.startswith("| `"):
            key, *values = [cell.strip(" `") for cell in line.strip("|").split("|")]
            rows[key] = values
    profiles = [load_profile(name).to_dict() for name in ("warthog", "small_rover", "car", "husky")]
    flat = [
        {k: v for k, v in p.items() if not isinstance(v, dict) and k not in {"name", "description"}}
        | {f"{k}.{kk}": vv for k, v in p.items() if isinstance(v, dict) for kk, vv in v.items()}
        for p in profiles
    ]
    assert list(rows) == list(flat[0]) == [key.name for key in KEYS]
    for key in KEYS:
        own = key.quantity
        assert f"| `{key.name}` | {own.unit} | {own.low:g} to {own.high:g} | {own.what} |" in schema
    for key, values in rows.items():
        for text, profile in zip(values, flat, strict=True):
            numbers = profile[key] if isinstance(profile[key], list) else [profile[key]]
            assert [float(number) for number in text.split(",")] == numbers
