"""Profiles of vehicles: what is refused, what follows from a few values, and the template."""

import json

import pytest

from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.rating import Vehicle, estimated_values, shipped_profiles
from bumpymap.rating.vehicle_profile import ESTIMATED, write_profile_template


@pytest.fixture
def warthog():
    return Vehicle.load("warthog").to_dict()


@pytest.mark.parametrize(("name", "mass"), [("warthog", 260), ("small_rover", 20), ("car", 1900), ("husky", 56.5)])
def test_a_shipped_profile_has_the_mass_of_its_vehicle(name, mass):
    assert name in shipped_profiles()
    profile = Vehicle.load(name)
    record = profile.to_dict()
    assert record["name"] == name
    assert Vehicle.from_dict(json.loads(json.dumps(record)), "x") == profile
    assert profile.mass_kg == pytest.approx(mass, abs=0.1)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("wheelbase_m", 920, ["wheelbase_m is 920; it must be a number from 0.1 to 20 m; 920 mm would be 0.92"]),
        ("wheelbase_m", "?", ["wheelbase_m is not filled in: a number from 0.1 to 20 m"]),
        ("wheelbase_m", 0.6, ["touch", "twice the radius"]),
        ("track_m", 0.2, ["track_m 0.2", "wheel width"]),
        ("description", "a\x1b[31m\n", [r"description is 'a\x1b[31m\n'", "one line"]),
        ("chassis", 3, ["chassis is 3", "table, [chassis], with mass_kg, inertia_kgm2, com_height_m"]),
        ("chassis.mass_kg", 100_000, ["100,160 kg", "between", "masses in kilograms"]),
        ("chassis.com_height_m", -0.31, ["com_height_m", "below the ground"]),
        ("chassis.inertia_kgm2", [6.0, 6.0, 12.1], ["sum of the two others"]),
        ("chassis.inertia_kgm2", [542.0, 1333.0, 1608.0], ["chassis.inertia_kgm2 is [542.0, 1333.0, 1608.0]", "box"]),
        ("belly.width_m", 0.9, ["belly.width_m is 0.9", "0.87 apart", "fit between"]),
        ("belly.length_m", 13, ["belly.length_m is 13", "4 times"]),
        ("body.height_m", 0.5, ["body.height_m is 0.5", "reach up to 0.6"]),
        ("body.width_m", 1.2, ["body.width_m is 1.2", "1.37 wide"]),
        ("floor", {"c_r_radpm": 0.4}, ["comfort.pitch_rate_radps is 0.3", "0.4 rad/s"]),
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


def test_body_above_the_wheels_may_be_wider_than_the_way_between_them(warthog):
    warthog["belly"].update(width_m=1.4, clearance_m=0.6)
    del warthog["body"]
    assert Vehicle.from_dict(warthog, "x").belly.width_m == 1.4


def test_all_faults_are_said_at_once(warthog):
    warthog |= {"wheelbase_m": 920, "slope_limit_deg": 0.52, "colour": "red"}
    warthog["wheel"]["radius"] = warthog["wheel"].pop("radius_m")
    del warthog["track_m"], warthog["belly"]
    with pytest.raises(BadInputError) as caught:
        Vehicle.from_dict(warthog, "my.toml")
    first, *faults = caught.value.args
    assert first.startswith("my.toml: 7 errors")
    told = "\n".join(faults)
    for words in (
        *("unknown setting colour", "wheelbase_m is 920", "slope_limit_deg is 0.52", "missing wheel.radius_m"),
        "[wheel]: unknown setting radius; there are: mass_kg, radius_m, width_m",
        "missing track_m: a number from 0.05 to 15 m",
        "missing belly: a table, [belly], with length_m, width_m, clearance_m",
    ):
        assert words in told


def test_fail_weight_and_an_outline_may_be_left_out(warthog):
    given = Vehicle.from_dict(warthog | {"body": {"brush_stem_m": 0.6}}, "x").body
    assert (given.height_m, given.width_m, given.brush_stem_m) == (1.38, 1.37, 0.6)
    del warthog["fail_weight"], warthog["body"]
    vehicle = Vehicle.from_dict(warthog, "x")
    assert vehicle.fail_weight == Vehicle.load("warthog").fail_weight
    # 2 * 0.3 + 0.7 * 1.12; 1.12 + 0.25
    assert (vehicle.body.height_m, vehicle.body.width_m, vehicle.body.brush_stem_m) == (1.38, 1.37, 0.25)
    assert Vehicle.from_dict(warthog | {"fail_weight": 40}, "x").fail_weight == 40.0


def test_an_unknown_name_lists_the_shipped_profiles_and_what_is_not_toml_is_refused(tmp_path):
    with pytest.raises(UsageError, match="car, husky, small_rover, warthog"):
        Vehicle.load("tank")
    (tmp_path / "mine.toml").write_text("name = ")
    with pytest.raises(BadInputError, match="cannot read the vehicle profile"):
        Vehicle.load(tmp_path / "mine.toml")


SHORT = {
    "name": "mine", "description": "A robot", "mass_kg": 260, "suspension": "rocker", "wheelbase_m": 0.92,
    "track_m": 1.12, "speed_mps": 1, "slope_limit_deg": 30, "wheel": {"radius_m": 0.3, "width_m": 0.25},
    "belly": {"clearance_m": 0.25},
}  # fmt: skip


HAUL_TRUCK = {
    "mass_kg": 155_000, "suspension": "sprung", "wheelbase_m": 4.8, "track_m": 4.2, "speed_mps": 8,
    "wheel": {"radius_m": 1.35, "width_m": 0.85}, "belly": {"clearance_m": 0.8},
}  # fmt: skip
ROVER_2_KG = {
    "mass_kg": 2, "wheelbase_m": 0.16, "track_m": 0.18, "speed_mps": 0.3,
    "wheel": {"radius_m": 0.045, "width_m": 0.03}, "belly": {"clearance_m": 0.03},
}  # fmt: skip
KINDS = {"warthog": "rocker", "small_rover": "rocker", "car": "sprung", "husky": "rigid"}


@pytest.mark.parametrize("change", [{}, {"suspension": "sprung"}, {"suspension": "rigid"}, HAUL_TRUCK, ROVER_2_KG])
def test_ten_values_make_a_whole_profile_of_2_kg_or_155_tonnes(change):
    given = SHORT | change
    vehicle = Vehicle.from_dict(given, "x")
    assert vehicle.mass_kg == pytest.approx(given["mass_kg"])
    assert vehicle.wheelbase_m == given["wheelbase_m"]
    assert (vehicle.wheel.radius_m, vehicle.wheel.width_m) == (given["wheel"]["radius_m"], given["wheel"]["width_m"])
    assert vehicle.belly.clearance_m == given["belly"]["clearance_m"]
    assert vehicle.ride_weight == Vehicle.load("warthog").ride_weight
    assert Vehicle.from_dict(vehicle.to_dict(), "x") == vehicle  # what a calibration keeps is a profile as well


@pytest.mark.parametrize("name", KINDS)
def test_estimates_are_near_the_values_of_the_included_vehicles(name):
    own = Vehicle.load(name)
    record = SHORT | {key: getattr(own, key) for key in ("mass_kg", "wheelbase_m", "track_m", "speed_mps")}
    record |= {"suspension": KINDS[name], "belly": {"clearance_m": own.belly.clearance_m}}
    record["wheel"] = {"radius_m": own.wheel.radius_m, "width_m": own.wheel.width_m}
    found = Vehicle.from_dict(record, "x")

    def pitching(vehicle):
        turned = 2 * vehicle.rocker.stiffness_nm_per_rad * vehicle.chassis.inertia_kgm2[1]
        return vehicle.rocker.stiffness_nm_per_rad / vehicle.chassis.inertia_kgm2[1], (
            vehicle.rocker.damping_nms_per_rad / turned**0.5
        )

    assert found.belly.length_m == pytest.approx(own.belly.length_m, rel=0.05)
    assert pitching(found) == pytest.approx(pitching(own), rel=0.35)
    assert found.chassis.com_height_m == pytest.approx(own.chassis.com_height_m, rel=0.25)


def test_what_a_short_profile_gives_stays_and_what_follows_from_it_follows():
    given = SHORT | {"chassis": {"inertia_kgm2": [5, 20, 20]}, "rocker": {"mass_kg": 10}}
    own = Vehicle.from_dict(SHORT, "x")
    found = Vehicle.from_dict(given, "x")
    assert found.chassis.inertia_kgm2 == (5, 20, 20)
    assert found.chassis.mass_kg == pytest.approx(own.chassis.mass_kg + 2 * (own.rocker.mass_kg - 10))
    assert found.rocker.stiffness_nm_per_rad / own.rocker.stiffness_nm_per_rad == pytest.approx(
        20 / own.chassis.inertia_kgm2[1], rel=1e-3
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"suspension": "air"}, ["suspension is 'air'; it must be one of rocker, sprung, rigid"]),
        ({"wheel": {"radius_m": 0.3}}, ["missing wheel.width_m: a number from"]),
        (
            {"wheel": {"radius_m": 0.3, "width_m": 0.25, "mass_kg": 70}},
            ["mass_kg is 260, and rockers and wheels alone weigh that much"],
        ),
        ({"chassis": {"mass_kg": 300}}, ["mass_kg is 260, and chassis, rockers and wheels weigh 404 together"]),
    ],
)
def test_a_faulty_short_profile_is_refused_without_what_would_be_estimated(change, words):
    with pytest.raises(BadInputError) as caught:
        Vehicle.from_dict(SHORT | change, "my.toml")
    assert all(word in str(caught.value) for word in ["my.toml", *words])
    assert "missing chassis" not in str(caught.value)
    assert "inertia" not in str(caught.value)
    parts = {key: value for key, value in SHORT.items() if key not in {"mass_kg", "suspension"}}
    with pytest.raises(BadInputError, match=r"(?s)(?=.*missing chassis: a table)(?=.*mass_kg and suspension)"):
        Vehicle.from_dict(parts, "my.toml")


def test_the_template_takes_ten_values(tmp_path):
    write_profile_template("mine", tmp_path / "mine.toml", None)
    text = (tmp_path / "mine.toml").read_text()
    assert text.count('= "?"') == 10
    for key, value in (SHORT | SHORT["wheel"] | SHORT["belly"]).items():
        text = text.replace(f'{key} = "?"', f"{key} = {json.dumps(value)}")
    (tmp_path / "mine.toml").write_text("\ufeff" + text, encoding="utf-8")
    assert Vehicle.load(tmp_path / "mine.toml") == Vehicle.from_dict(SHORT, "x")
    assert set(estimated_values(tmp_path / "mine.toml")) == set(ESTIMATED)
    assert estimated_values("warthog") == {}
