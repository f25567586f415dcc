"""Drives held against a map: what is measured where pitch and way are known, what is refused, the files of a check."""

import hashlib
import html
import json
from dataclasses import replace

import made_drives
import numpy as np
import pytest
from check_records import LIMITS, STRETCH_M, made_up_check, stretches_at
from pyproj import Geod
from route_maps import bare_map
from scipy.stats import spearmanr
from small_surveys import run
from tile_maps import MadeUpMap

from bumpymap.check.inertial import even_imu
from bumpymap.check.measure import find_standing, measure_drive, rough_speed
from bumpymap.check.pipeline import agreement_of, check_drives, write_check
from bumpymap.check.places import local_metres, metre_places, places_on_map
from bumpymap.check.stretches import cut_stretches
from bumpymap.core import BadInputError, CheckConfig, ImuTrack, PlaceTrack, UsageError, WheelTrack
from bumpymap.layers.products import CHECK_FILES, CHECK_MANIFEST_NAME
from bumpymap.rating import less_floor
from bumpytiles import TileWindow


def measured(log):
    places = None if log.places is None else metre_places(log.places, log.places.x, log.places.y, log.name)
    found = measure_drive(log, places, 10.0)
    return found, cut_stretches(found, 10.0)[1]


def true_c_r(log, cut, pitch_rate, way):
    step = log.imu.time[1] - log.imu.time[0]
    turned = np.concatenate([[0.0], np.cumsum(np.abs(pitch_rate)) * step])
    at = np.append(log.imu.time, log.imu.time[-1] + step)
    whole = np.append(way, way[-1])
    return (np.interp(cut.end_s, at, turned) - np.interp(cut.start_s, at, turned)) / (
        np.interp(cut.end_s, at, whole) - np.interp(cut.start_s, at, whole)
    )


def first_of(track, count):
    return PlaceTrack(*(part[:count] for part in (track.time, track.x, track.y, track.error)), track.kind)


@pytest.fixture(scope="module")
def good():
    made = made_drives.MadeDrive(
        offset=0.31,
        mount_deg=(3.0, -4.0, 5.0),
        noise=0.01,
        bias=0.01,
        place_white=0.015,
        place_wander=0.01,
        seconds=110.0,
    )
    log, pitch_rate, way = made_drives.log_of(made)
    return made, log, pitch_rate, way, *measured(log)


def test_c_r_of_each_stretch_is_that_of_the_drive(good):
    _, log, pitch_rate, way, _, cut = good
    true = true_c_r(log, cut, pitch_rate, way)
    assert len(true) >= 6
    assert np.median(np.abs(cut.measured / true - 1.0)) < 0.03
    assert (np.abs(cut.measured - true) < 3.0 * cut.measured_sd).mean() > 0.9


def test_clock_mounting_floor_and_way_are_found(good):
    made, _, _, way, found, _ = good
    assert found.clock_offset_s == pytest.approx(made.offset, abs=0.04)
    assert found.mount_deg[:2] == pytest.approx(made.mount_deg[:2], abs=0.5)
    assert found.mount_deg[2] == pytest.approx(made.mount_deg[2], abs=2.0)
    in_band = made.noise * np.sqrt(2.0 * found.band_hz / made.hertz)  # of white noise
    assert found.floor_radps == pytest.approx(in_band * np.sqrt(2.0 / np.pi), rel=0.2)
    assert np.abs(found.speed).sum() / found.hertz == pytest.approx(way[-1], rel=0.01)


@pytest.mark.parametrize(("offset", "turning"), [(-1.0, 1.0), (0.5, 0.0)])
def test_the_clock_is_found_within_its_stated_error_by_starts_and_stops(offset, turning):
    """The errors of the positions are no knowledge of the clock: stated errors of 0.02 s went with 0.06 s."""
    stops = ((25.0, 29.0), (45.0, 50.0), (65.0, 69.0))
    made = made_drives.MadeDrive(offset=offset, turning=turning, stops=stops, noise=0.01, bias=0.01, place_white=0.01)
    found, _ = measured(made_drives.log_of(replace(made, seconds=95.0))[0])
    assert abs(found.clock_offset_s - offset) < min(3.0 * found.clock_offset_sd_s, 0.03)
    assert 0.01 < found.clock_offset_sd_s < 0.05


def test_noise_of_positions_does_not_lengthen_the_way():
    log, _, way = made_drives.log_of(
        made_drives.MadeDrive(noise=0.01, place_white=0.25, place_wander=1.5, seed=5, seconds=90.0)
    )
    found, cut = measured(log)
    assert np.abs(found.speed).sum() / found.hertz == pytest.approx(way[-1], rel=0.06)
    assert 0.5 < found.track.scatter.wander_m < 4.0
    assert (cut.measured_sd > 0.02 * cut.measured).all()


def test_a_sensor_upside_down_reads_the_same(good):
    made = replace(good[0], mount_deg=(180.0, 0.0, 0.0), seconds=60.0)
    log, pitch_rate, way = made_drives.log_of(made)
    found, cut = measured(log)
    assert abs(found.mount_deg[0]) == pytest.approx(180.0, abs=1.0)
    assert np.median(np.abs(cut.measured / true_c_r(log, cut, pitch_rate, way) - 1.0)) < 0.03


def test_without_positions_the_way_is_that_of_the_wheels(good):
    _, log, pitch_rate, way, _, _ = good
    speed = np.gradient(way, log.imu.time)
    wheels = WheelTrack(log.imu.time[::5], speed[::5], np.full(len(speed[::5]), np.nan))
    found, cut = measured(replace(log, places=None, wheels=wheels))
    assert np.isnan(found.clock_offset_s)
    assert np.abs(found.speed).sum() / found.hertz == pytest.approx(way[-1], rel=0.02)
    assert np.median(np.abs(cut.measured / true_c_r(log, cut, pitch_rate, way) - 1.0)) < 0.04


def test_a_gap_of_the_imu_does_not_count_and_a_drive_without_accelerometer_says_so(good):
    _, log, _, _, _, _ = good
    keep = (log.imu.time < 60.0) | (log.imu.time > 64.0)
    imu = ImuTrack(log.imu.time[keep], log.imu.rate[keep], log.imu.acceleration[keep])
    found, _ = measured(replace(log, imu=imu))
    inside = (found.time > 60.1) & (found.time < 63.9)
    assert (found.reason[inside] == 1).all()
    assert (cut_stretches(found, 10.0)[0][inside] == -1).all()
    imu = replace(log.imu, acceleration=np.full_like(log.imu.acceleration, np.nan))
    found, _ = measured(replace(log, imu=imu))
    assert np.isnan(found.mount_deg).all()
    assert any("no accelerometer" in note for note in found.notes)


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda log: {"imu": ImuTrack(log.imu.time[::5], log.imu.rate[::5], log.imu.acceleration[::5])}, "`band_hz`"),
        (lambda log: {"imu": replace(log.imu, rate=np.degrees(log.imu.rate))}, "in degrees per second, say so"),
        (lambda log: {"imu": replace(log.imu, rate=np.radians(log.imu.rate))}, "radians per second read as degrees"),
        (lambda log: {"places": replace(log.places, time=log.places.time + 1e6)}, "in common"),
        (lambda _: {"places": None}, "neither positions nor wheel speeds"),
        (lambda log: {"places": first_of(log.places, 5)}, "5 usable positions"),
    ],
)
def test_a_log_that_cannot_be_measured_is_refused(good, damage, told):
    log = good[1]
    with pytest.raises(BadInputError, match=told):
        measured(replace(log, **damage(log)))


def test_a_short_way_tells_no_offset_of_the_clocks_and_rough_positions_none_or_its_error():
    log, _, _ = made_drives.log_of(made_drives.MadeDrive(seconds=32.0, offset=0.3, noise=0.01, place_white=0.015))
    assert np.isnan(measured(log)[0].clock_offset_s)
    made = made_drives.MadeDrive(
        offset=0.31, noise=0.01, place_white=0.25, place_wander=1.5, turning=0.3, seed=3, seconds=80.0
    )
    found, _ = measured(made_drives.log_of(made)[0])
    assert not abs(found.clock_offset_s - made.offset) > 3.0 * found.clock_offset_sd_s


def test_the_way_of_a_long_drive_is_found_as_well(good, monkeypatch):
    _, log, pitch_rate, way, found, cut = good
    monkeypatch.setattr("bumpymap.check.track._TRIED_KNOTS", 240)
    again, cut_again = measured(log)
    assert again.track.offset_s == pytest.approx(found.clock_offset_s, abs=0.02)
    assert np.abs(again.speed).sum() / again.hertz == pytest.approx(way[-1], rel=0.01)
    assert np.median(np.abs(cut_again.measured / true_c_r(log, cut_again, pitch_rate, way) - 1.0)) < 0.03
    assert cut_again.measured_sd == pytest.approx(cut.measured_sd, rel=0.2)


@pytest.mark.parametrize("on_the_spot", [False, True])
def test_slow_driving_over_even_ground_is_no_standstill(on_the_spot):
    made = made_drives.MadeDrive(amplitude=0.002, speed=0.1, seconds=60.0, noise=0.01, turning=0.0)
    log, *_ = made_drives.log_of(made)
    imu = even_imu(log.imu, "slow", 10.0)
    time, speed = (axis[::20] for axis in made_drives.motion(made)[:2])
    still = np.zeros(len(time))  # on the spot, the sides turn against each other
    wheels = WheelTrack(time, *((still, 2 * speed) if on_the_spot else (speed, still)))
    standing = find_standing(imu, rough_speed(imu, None, wheels), 10.0)
    driven = (imu.time > made.stand + 1.0) & (imu.time < made.seconds - made.stand / 2 - 1.0)
    assert not standing[driven].any()
    assert standing[imu.time < made.stand - 1.0].mean() > 0.8


def test_independent_noise_is_taken_off_in_power():
    rng = np.random.default_rng(1)
    signal, noise = rng.normal(0, 0.2, 400_000), rng.normal(0, 0.1, 400_000)
    read, floor = np.abs(signal + noise).mean(), np.abs(noise).mean()
    assert less_floor(read, floor) == pytest.approx(np.abs(signal).mean(), rel=5e-3)
    assert less_floor(np.array([0.01]), np.array([0.02])) == 0.0


def test_agreement_by_hand_and_by_scipy_ties_included():
    measured = np.array([0.10, 0.20, 0.30, 0.40, 0.40, 0.50, 0.0])
    c_r = np.array([0.11, 0.30, 0.30, 0.42, 0.20, np.nan, 0.2])
    driven = stretches_at(np.zeros((7, 2)), c_r, 1.0, sd=0.0)
    classes = np.digitize(measured, LIMITS).astype(np.uint8)
    driven = replace(driven, measured=measured, measured_sd=np.zeros(7), place_sd=np.zeros(7), measured_class=classes)
    found = agreement_of(driven)
    assert (found.stretches, found.way_m) == (5, 5 * STRETCH_M)
    assert found.spearman == pytest.approx(spearmanr(c_r[:5], measured[:5]).statistic)
    assert found.median_ratio == pytest.approx(np.median([1.1, 1.5, 1.0, 1.05, 0.5]))
    assert found.median_error == pytest.approx(np.median([0.1, 0.5, 0.0, 0.05, 0.5]))
    assert (found.inside, found.same_class) == (3 / 5, 3 / 5)
    assert np.isnan(agreement_of(driven, np.arange(7) < 4).spearman)  # of four


def test_local_metres_are_those_of_the_ellipsoid():
    lon, lat = np.array([-99.0, -99.0, -98.99]), np.array([19.0, 19.01, 19.0])
    east, north = local_metres(lon, lat)
    _, _, metres = Geod(ellps="WGS84").inv(lon[[0, 0]], lat[[0, 0]], lon[1:], lat[1:])
    assert np.hypot(east[1:] - east[0], north[1:] - north[0]) == pytest.approx(metres, rel=1e-4)


SITE = bare_map(TileWindow(0, 0, 100, 100), crs=None)


def test_drives_are_measured_without_a_map_and_those_that_cannot_be_used_are_named(tmp_path):
    """One of them is no file of a drive, and one is refused when it is measured."""
    good, bad, parked = (str(tmp_path / f"{name}.csv") for name in ("good", "bad", "parked"))
    log, *_ = made_drives.log_of(made_drives.MadeDrive(seconds=36.0, noise=0.01, place_white=0.015))
    made_drives.write_table(tmp_path / "good.csv", log, (0.0, 0.0))
    (tmp_path / "bad.csv").write_text("hello")
    made_drives.write_table(tmp_path / "parked.csv", placed("projected", still=True), (0.0, 0.0))
    words = ["check", "--drive", bad, "--drive", parked, "--drive", good, "--out", str(tmp_path / "out")]
    done = run(*words, code=4)
    result = json.loads((tmp_path / "out" / "check.json").read_text())
    (drive,) = result["drives"]
    assert drive["name"] == "good"
    assert drive["way_m"] == pytest.approx(drive["used_m"] + sum(drive["left_out_m"].values()))
    assert drive["speed_mps"] == pytest.approx(1.0, rel=0.05)
    assert (result["map"], result["agreement"], result["line"]) == (None, None, None)
    stretches = result["stretches"]
    assert None not in stretches["measured"]
    assert set(stretches["c_r"] + stretches["class_id"]) == {None}
    page = html.unescape((tmp_path / "out" / "check.html").read_text())
    for drive, told in ((bad, "no table"), (parked, "never drives")):
        assert told in result["skipped"][drive]
        assert all(f"{drive} is left out: {result['skipped'][drive]}" in text for text in (done.output, page))
        assert done.output.count(f"{drive} is left out") == 1
    quiet = run(*words[:3], *words[5:7], "--quiet", code=4)
    assert quiet.stdout == ""
    assert f"{bad} is left out: {result['skipped'][bad]}" in quiet.stderr


def test_with_no_usable_drive_there_is_no_check(tmp_path):
    words = [tmp_path / "one.csv", tmp_path / "two.csv"]
    with pytest.raises(BadInputError, match=r"(?s)one\.csv.*two\.csv"):
        check_drives(None, words)
    for drives, told in (((), "no drive"), (("a.csv", "b.csv", "a.csv"), "twice")):
        with pytest.raises(UsageError, match=told):
            CheckConfig(drives)
    command = ["check", *(word for path in words for word in ("--drive", str(path)))]
    run(*command, code=3)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "check.json").touch()
    done = run(*command, "--out", tmp_path / "out")
    assert "one.csv" in done.output  # told before that the folder is occupied
    done = run("check", tmp_path / "none", *command[1:], "--out", tmp_path / "out")
    assert "there is no folder" in done.output


def placed(kind: str, shift: float = 0.0, *, still: bool = False):
    made = {"seconds": 20.0, "speed": 0.0} if still else {"seconds": 40.0}
    log, _, _ = made_drives.log_of(made_drives.MadeDrive(**made))
    track = log.places
    return replace(log, places=PlaceTrack(track.time, track.x + 50 + shift, track.y + 50, track.error, kind))


@pytest.mark.parametrize(
    ("log", "told"),
    [
        (lambda: placed("projected", 9e5), r"off the map: the drive lies around 9\d{5}.*spans x 0\.00 to 300\.00"),
        (lambda: placed("local"), "odometry"),
        (lambda: placed("lonlat"), "no CRS"),
        (lambda: replace(placed("projected"), places=None), "no positions"),
    ],
)
def test_positions_that_cannot_be_placed_are_refused(log, told):
    with pytest.raises(BadInputError, match=told):
        places_on_map(log(), SITE)


ALL = sorted(CHECK_FILES.names)
WITHOUT_MAP = ["check.html", "check.json"]
SETTINGS = {"settings": {"band_hz": 10.0, "window_m": 10.0}}


@pytest.fixture(scope="module")
def ground():
    return MadeUpMap.around()


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_gets_every_file_and_the_manifest(ground, tmp_path):
    out = tmp_path / "new" / "checked"
    files = write_check(made_up_check(), out, ground=ground, manifest=SETTINGS)
    assert names(out) == ALL == sorted(path.name for path in files)
    record = json.loads((out / CHECK_MANIFEST_NAME).read_text())
    assert record["format"] == "bumpymap-check"
    assert record["settings"] == SETTINGS["settings"]
    assert record["calibration"]["id"] == "c0ffee"
    assert record["crs"]["code"] == "EPSG:32614"
    checksum = hashlib.sha256((ground.folder / "run.json").read_bytes()).hexdigest()
    assert record["layers"] == [{"path": str(ground.folder), "run_sha256": checksum}]
    listed = [entry["path"] for entry in record["files"]]
    assert listed == ["check.html", "check.geojson"]
    for entry in record["files"]:
        assert entry["sha256"] == hashlib.sha256((out / entry["path"]).read_bytes()).hexdigest()
    for again in write_check(made_up_check(), tmp_path / "again", ground=ground, manifest=SETTINGS):
        assert again.read_bytes() == (out / again.name).read_bytes()


@pytest.mark.parametrize("has_map", [True, False])
def test_without_a_map_or_positions_there_is_nothing_for_gis(ground, tmp_path, has_map):
    result, nowhere = made_up_check(ground=has_map), np.full(40, np.nan)
    result = replace(result, stretches=replace(result.stretches, easting=nowhere, northing=nowhere))
    write_check(result, tmp_path, ground=ground if has_map else None)
    assert names(tmp_path) == WITHOUT_MAP
    record = json.loads((tmp_path / "check.json").read_text())
    assert [bool(record[name]) for name in ("map", "agreement", "by_class")] == [has_map] * 3


@pytest.mark.parametrize("options", [{}, {"ground": False}, {"unknown": [0, 3]}])
def test_the_record_holds_all_that_was_found_and_null_where_nothing_is_known(ground, tmp_path, options):
    result = made_up_check(**options)
    odd = replace(result.drives[0], clock_offset_s=float("nan"), name='"<\n\u00e9')
    write_check(replace(result, drives=(odd,)), tmp_path, ground=ground if result.ground else None, manifest=SETTINGS)
    record = json.loads((tmp_path / "check.json").read_text())
    assert (record["drives"][0]["clock_offset_s"], record["drives"][0]["name"]) == (None, odd.name)
    of_line = (record["line"] or {}).get("stretches", {})
    for told, of in ((record["stretches"], result.stretches), (of_line, result.by_line)):
        for name, values in told.items():
            found = np.array([(255 if "class" in name else np.nan) if value is None else value for value in values])
            np.testing.assert_array_equal(found, getattr(of, name))
    assert (record["line"] is None) == (result.ground is None)
