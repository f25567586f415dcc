"""Calibrations and profiles of vehicles: files and ids, what is refused, what follows, and one moved to drives."""

import json
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from check_records import driven_stretches

from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.rating import Correction, RideModel, Rides, map_calibration, shipped_profiles, update_from_drives
from bumpymap.rating.calibration import Calibration, find_calibration, shipped_calibrations
from bumpymap.rating.drive_update import (
    DriveEvidence,
    DrivePrior,
    LogMove,
    collect_evidence,
    fit_move,
    moved_calibration,
    respond,
)
from bumpymap.rating.ride.thin import THIN_COLUMNS, Strength, ThinModel
from bumpymap.rating.vehicle_profile import ESTIMATED, Vehicle, estimated_values, write_profile_template

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


CALIBRATION = Calibration.shipped("warthog")


def test_500_metres_bring_the_median_ratio_to_within_5_percent():
    for seed, shift in ((1, 0.35), (2, -0.35)):
        _, update = update_from_drives(CALIBRATION, driven_stretches(CALIBRATION, 50, shift=shift, seed=seed))
        assert update.ratio[0] == pytest.approx(np.exp(-shift), rel=0.08)
        assert update.ratio[1] == pytest.approx(1.0, abs=0.05)
        low, middle, high = update.factor
        assert low < middle < high
        assert middle == pytest.approx(np.exp(shift), rel=0.08)
        assert update.held_out_error[1] < 0.6 * update.held_out_error[0]
        assert (update.way_m, update.stretches, update.drives) == (500.0, 50, 1)
        assert update.new_m == pytest.approx(500.0)


def test_the_new_calibration_is_the_old_one_moved_by_the_posterior():
    stretches = driven_stretches(CALIBRATION, 60, tilt=0.1)
    new, update = update_from_drives(CALIBRATION, stretches)
    assert update_from_drives(CALIBRATION, stretches)[0].to_json() == new.to_json()
    shift, tilt = update.posterior.mean
    middle = np.log(CALIBRATION.class_limits[1])
    wanted = [middle + shift + (1 + tilt) * (np.log(c_r) - middle) for c_r in CALIBRATION.steps["tile"]["c_r"]]
    assert np.log(new.steps["tile"]["c_r"]) == pytest.approx(wanted)
    assert RideModel(new).calibration.vehicle == CALIBRATION.vehicle
    record = json.loads(json.dumps(new.settings["moved_to_drives"]))
    assert record["calibration_id"] == CALIBRATION.id
    assert record["way_m"] == 600.0
    assert record["posterior"]["mean"] == pytest.approx([shift, tilt])


def test_drives_that_are_short_or_agree_or_moved_it_already_move_nothing():
    moved, _ = update_from_drives(CALIBRATION, driven_stretches(CALIBRATION))
    ten, fifty = driven_stretches(CALIBRATION, 10), driven_stretches(CALIBRATION, 50)
    fifty.speed_mps[10:] = 3.0
    laps = replace(ten, **{name: np.tile(getattr(ten, name), 10) for name in ten.__slots__})
    for calibration, made, words in (
        (CALIBRATION, ten, r"100 m of different ground on 10 stretches count\. It takes at least 200 m"),
        (CALIBRATION, fifty, r"100 m of .* \(left out: 400 m not near the 1 m/s of the map\)"),
        (CALIBRATION, laps, "100 m of different ground on 100 stretches"),
        (CALIBRATION, driven_stretches(CALIBRATION, 60, shift=0.0), r"agree .* room for a factor of 0\.9\d to 1\.0\d"),
        (moved, driven_stretches(CALIBRATION), f"against a map made with the calibration {CALIBRATION.id}"),
    ):
        with pytest.raises(BadInputError, match=words):
            update_from_drives(calibration, made)


def test_variances_are_those_of_the_logarithm_and_the_floor_is_taken_off_in_power():
    made = driven_stretches(CALIBRATION, 50, shift=0.0, sd=1e-9, map_sd=0.2)
    made.measured[:] = made.c_r
    made.measured_sd[:], made.place_sd[:] = 0.03 * made.c_r, 0.04 * made.c_r
    evidence, _ = collect_evidence(made, 1.0, 0.0)
    assert np.sqrt(evidence.own_variance) == pytest.approx(0.05)
    assert evidence.map_sd == pytest.approx(0.2, rel=1e-4)
    before = np.log(made.c_r)
    made.c_r[:] = np.hypot(made.c_r, 0.03)
    assert collect_evidence(made, 1.0, 0.03)[0].log_c_r == pytest.approx(before)


MIDDLE = np.log(0.25)
PRIOR = DrivePrior(MIDDLE, (0.2, 0.1), -np.inf)


def evidence_of(rng, n=45, numbers=(0.2, 0.05), *, prior=PRIOR, scale=1.0, line_sd=0.1):
    """Stretches in squares of three; what the map is off by is ``scale`` times what it says."""
    square = np.arange(n) // 3
    log_c_r = MIDDLE - 0.3 + rng.normal(0, 0.7, n)
    map_sd, sd = np.full(n, 0.1), np.full(n, 0.05)
    off = scale * map_sd * rng.normal(size=n)[square] + np.hypot(sd, line_sd) * rng.normal(size=n)
    measured = respond(np.array(numbers), log_c_r, prior)[0] + off
    whole = np.zeros(n, np.int64)
    return DriveEvidence(log_c_r, measured, sd**2, map_sd, square, whole, whole, np.full(n, 10.0), np.full(n, 10.0))


@pytest.mark.parametrize(("options", "low"), [({"line_sd": 0.25}, 0.7), ({"scale": 1.5, "n": 60}, 0.65)])
def test_the_stated_uncertainty_holds(options, low):
    """The 80 % interval of both numbers, over drives whose numbers are drawn from the prior."""
    inside = []
    for seed in range(16):
        rng = np.random.default_rng([seed, 5])
        numbers = rng.normal(0.0, PRIOR.sd)
        found = fit_move(evidence_of(rng, numbers=numbers, **options), PRIOR)
        inside.append(np.abs(found.mean - numbers) < 1.2816 * np.sqrt(np.diag(found.covariance)))
    assert low < np.mean(inside) < 0.92


def test_wild_stretches_hardly_move_anything():
    evidence = evidence_of(np.random.default_rng(4), 60, scale=0.5)
    calm = fit_move(evidence, PRIOR)
    evidence.log_measured[::15] += 2.0
    wild = fit_move(evidence, PRIOR)
    assert abs(wild.mean[0] - calm.mean[0]) < 0.05
    assert wild.covariance[0, 0] > calm.covariance[0, 0]


def test_ground_driven_again_says_little_more():
    """Five passes over the same squares, each with its own measurement, where the map's error rules."""
    once = evidence_of(np.random.default_rng(5), 30, line_sd=0.0)
    once.own_variance[:] = 0.02**2
    rows = np.tile(np.arange(30), 5)
    again = once.chosen(rows)
    apart = DriveEvidence(**{n: getattr(again, n) for n in again.__slots__} | {"square": np.arange(150) // 3})
    sd = [np.sqrt(fit_move(each, PRIOR).covariance[0, 0]) for each in (once, again, apart)]
    assert sd[1] > 0.8 * sd[0]
    assert sd[2] < 0.6 * sd[0]


def test_a_floor_is_found():
    prior = DrivePrior(MIDDLE, (0.2, 0.1, 1.0), np.log(0.02))
    numbers = np.array([0.2, 0.05, np.log(0.06)])
    rng = np.random.default_rng(7)
    evidence = evidence_of(rng, 200, prior=prior, numbers=numbers, scale=0.5)
    evidence.log_c_r[:] -= 1.0
    evidence.log_measured[:] = respond(numbers, evidence.log_c_r, prior)[0] + 0.05 * rng.normal(size=200)
    assert fit_move(evidence, prior).mean[2] == pytest.approx(np.log(0.06), abs=0.1)


def moved_by(calibration, shift=0.3, tilt=0.08, sd=(0.03, 0.04), widening=1.0):
    move = LogMove(math.log(calibration.class_limits[1]), shift, tilt, np.diag(np.square(sd)), widening)
    return move, moved_calibration(calibration, move, {"way_m": 512.0})


def rides_of(log_g, rng):
    g = np.exp(log_g)
    n = len(g)
    same = Rides(**{field.name: 0.2 * g for field in fields(Rides)})
    return replace(
        same, pitch_change=g, pitch_change_rms=g * np.exp(rng.uniform(0, 0.6, n)), belly_reach=np.full(n, 0.5)
    )


@pytest.mark.parametrize("name", shipped_calibrations())
def test_predictions_inside_the_range_are_the_moved_ones(name):
    old = Calibration.shipped(name)
    move, new = moved_by(old)
    was, now = (Correction.from_record(each.ride) for each in (old, new))
    low, high = was.log_range
    rng = np.random.default_rng(1)
    log_g = rng.uniform(low, high, 200)
    rides, slope = rides_of(log_g, rng), rng.uniform(0, 25, 200)
    felt = np.where(np.arange(200) % 3 == 0, np.nan, np.exp(log_g) * rng.uniform(0, 0.5, 200))
    points = rng.uniform(0.5, 50, 200)
    before, after = (each.predict(rides, slope, felt, points) for each in (was, now))
    assert after.log_c_r == pytest.approx(move.log(before.log_c_r), abs=1e-7)
    assert np.array_equal(after.p_fail, before.p_fail)
    assert np.all(after.below > before.below)
    middle = np.abs(before.log_c_r - move.middle) < 0.5
    assert np.all(after.below[middle] < 1.5 * before.below[middle])


@pytest.mark.parametrize("name", shipped_calibrations())
def test_thin_tiles_steps_and_the_table_move_too(name):
    old = Calibration.shipped(name)
    move, new = moved_by(old)
    ground = np.mean(ThinModel.from_record(old.thin).relief)
    columns = np.full((1, len(THIN_COLUMNS)), 0.3)
    columns[:, :2] = 30.0, 1.0
    strength = Strength(*np.array([[ground], [0.1], [-4.5]]))
    was, now = (ThinModel.from_record(each.thin).predict(columns, strength) for each in (old, new))
    assert now.log_c_r == pytest.approx(move.log(was.log_c_r))
    assert np.array_equal(now.p_fail, was.p_fail)
    assert new.steps["tile"]["c_r"] == pytest.approx(np.exp(move.log(np.log(old.steps["tile"]["c_r"]))))
    assert new.steps["tile"]["p_fail"] == old.steps["tile"]["p_fail"]
    assert new.steps["crossing"] == old.steps["crossing"]
    known = [(a, b) for x, y in zip(old.c_r, new.c_r, strict=True) for a, b in zip(x, y, strict=True) if a is not None]
    assert [b for _, b in known] == pytest.approx([math.exp(move.log(math.log(a))) for a, _ in known])
    assert new.class_limits == old.class_limits
    edges = [0.0, *old.class_limits, math.inf]
    assert all(a <= mean <= b for a, mean, b in zip(edges, new.class_c_r, edges[1:], strict=False))


def test_intervals_widen_by_what_is_not_known_and_by_what_drives_scatter():
    sd = math.exp(np.mean(CALIBRATION.ride["spread"]))
    for wanted, options in (
        (math.hypot(sd, 0.05), {"sd": (0.05, 0.0)}),
        (1.5 * sd, {"sd": (0.0, 0.0), "widening": 1.5}),
    ):
        _, new = moved_by(CALIBRATION, tilt=0.0, **options)
        assert np.exp(np.mean(new.ride["spread"])) == pytest.approx(wanted, rel=0.02)


def test_the_file_reads_back_and_fits_the_vehicle():
    _, new = moved_by(CALIBRATION)
    again = Calibration.from_json(new.to_json(), "moved.json")
    assert again.id == new.id != CALIBRATION.id
    assert again.settings["moved_to_drives"] == {"way_m": 512.0}
    assert again.vehicle == CALIBRATION.vehicle
    mine = replace(CALIBRATION.profile, ride_weight=9.0)
    assert new.with_preferences(mine, "moved.json").vehicle["ride_weight"] == 9.0
