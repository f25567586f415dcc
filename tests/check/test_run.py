"""A check as a user runs it: readings with and without a map, refusals, and its folder, written and read again."""

import hashlib
import html
import json
from dataclasses import asdict, replace
from pathlib import Path

import made_drives
import numpy as np
import pytest
from check_records import made_up_check
from click.testing import CliRunner
from route_maps import bare_map
from route_records import MadeUpMap

from bumpymap.check import check_drives
from bumpymap.check.pipeline import write_check
from bumpymap.check.places import places_on_map
from bumpymap.cli import main
from bumpymap.core import BadInputError, OutputError, PlaceTrack, UsageError
from bumpymap.layers import check_check_out
from bumpymap.layers.check_record import CHECK_FILES, CHECK_MANIFEST_NAME, read_check
from bumpytiles import TileWindow

SITE = bare_map(TileWindow(0, 0, 100, 100), crs=None)


def csv_of(path: Path) -> str:
    """Write the log of a drive as tables; return the place to read it from."""
    log, _, _ = made_drives.log_of(made_drives.MadeDrive(seconds=60.0, noise=0.01, place_white=0.015))
    imu = np.column_stack([log.imu.time, log.imu.rate, log.imu.acceleration])
    head = "time [s],gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s],acc_x [m/s2],acc_y [m/s2],acc_z [m/s2]"
    np.savetxt(path / "imu.csv", imu, delimiter=",", header=head, comments="")
    lon, lat = -99.0 + log.places.x / 105_000.0, 19.0 + log.places.y / 110_700.0
    places = np.column_stack([log.places.time, lon, lat])
    np.savetxt(path / "gnss.csv", places, delimiter=",", header="time [s],longitude [deg],latitude [deg]", comments="")
    return f"{path / 'imu.csv'},{path / 'gnss.csv'}"


def test_drives_are_measured_without_a_map_and_those_that_cannot_be_used_are_named(tmp_path):
    """One of them is no file of a drive, and one is refused when it is measured."""
    good, bad, parked = csv_of(tmp_path), str(tmp_path / "bad.csv"), str(tmp_path / "parked.csv")
    (tmp_path / "bad.csv").write_text("hello")
    made_drives.write_table(tmp_path / "parked.csv", placed("projected", still=True), (0.0, 0.0))
    words = ["check", "--drive", bad, "--drive", parked, "--drive", good, "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 4
    result, _ = read_check(tmp_path / "out")
    (drive,) = result.drives
    assert drive.name == "imu,gnss"
    assert drive.way_m == pytest.approx(drive.used_m + sum(drive.left_out_m.values()))
    assert drive.speed_mps == pytest.approx(1.0, rel=0.05)
    assert (result.ground, result.agreement) == (None, None)
    assert np.isfinite(result.stretches.measured).all()
    assert np.isnan(result.stretches.c_r).all()
    assert (result.stretches.class_id == 255).all()
    page = html.unescape((tmp_path / "out" / "check.html").read_text())
    for drive, told in ((bad, "no table"), (parked, "never drives")):
        assert told in result.skipped[drive]
        assert all(f"{drive} is left out: {result.skipped[drive]}" in text for text in (done.output, page))
        assert done.output.count(f"{drive} is left out") == 1
    quiet = CliRunner().invoke(main, [*words[:3], *words[5:7], "--quiet"])
    assert (quiet.exit_code, quiet.stdout) == (4, "")
    assert f"{bad} is left out: {result.skipped[bad]}" in quiet.stderr


def test_with_no_usable_drive_there_is_no_check(tmp_path):
    words = [tmp_path / "one.csv", tmp_path / "two.csv"]
    with pytest.raises(BadInputError, match=r"(?s)one\.csv.*two\.csv"):
        check_drives(None, words)
    command = ["check", *(word for path in words for word in ("--drive", str(path)))]
    assert CliRunner().invoke(main, command).exit_code == 3
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "check.json").touch()
    done = CliRunner().invoke(main, [*command, "--out", str(tmp_path / "out")])
    assert "one.csv" in done.output  # told before that the folder is occupied
    done = CliRunner().invoke(main, ["check", str(tmp_path / "none"), *command[1:], "--out", str(tmp_path / "out")])
    assert "there is no folder" in done.output


def placed(kind: str, shift: float = 0.0, *, still: bool = False):
    log, _, _ = made_drives.log_of(made_drives.MadeDrive(seconds=40.0, speed=0.0 if still else 1.0))
    track = log.places
    return replace(log, places=PlaceTrack(track.time, track.x + 50 + shift, track.y + 50, track.error, kind))


@pytest.mark.parametrize(
    ("log", "told"),
    [
        (lambda: placed("projected", 9e5), r"off the map: the drive lies around 9\d{5}.*covers 0\.0 to 300\.0"),
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
    assert record["calibration"] == {"id": "c0ffee"}
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


def test_files_of_an_earlier_check_are_replaced_only_if_asked_and_none_is_left(ground, tmp_path):
    write_check(made_up_check(), tmp_path, ground=ground)
    before = (tmp_path / "check.json").read_bytes()
    with pytest.raises(OutputError, match=r"already holds check\.html.*overwrite=True"):
        write_check(made_up_check(seed=6), tmp_path, ground=ground)
    assert (tmp_path / "check.json").read_bytes() == before
    (tmp_path / "my notes.txt").write_text("mine")
    write_check(made_up_check(seed=6), tmp_path, ground=ground, overwrite=True)
    assert (tmp_path / "check.json").read_bytes() != before
    write_check(made_up_check(ground=False), tmp_path, overwrite=True)
    assert names(tmp_path) == [*WITHOUT_MAP, "my notes.txt"]


def test_the_folder_of_a_map_and_files_are_refused(ground, tmp_path):
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(UsageError, match="holds the layers of a survey"):
        write_check(made_up_check(), tmp_path, ground=ground, overwrite=True)
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="it is a file"):
        check_check_out(tmp_path / "file", overwrite=True)
    with pytest.raises(UsageError, match=r"named like a \.json file, but a check is a folder"):
        check_check_out(tmp_path / "check.json", overwrite=False)
    (tmp_path / "other" / "check.html").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"check\.html is not a file"):
        check_check_out(tmp_path / "other", overwrite=True)


@pytest.mark.parametrize("options", [{}, {"ground": False}, {"unknown": [0, 3]}, {"drives": 3}])
def test_what_was_written_is_read_again(ground, tmp_path, options):
    result = made_up_check(**options)
    odd = replace(result.drives[0], clock_offset_s=float("nan"), mount_deg=(float("nan"),) * 3, name='"<\n\u00e9')
    result = replace(result, drives=(odd, *result.drives[1:]))
    write_check(result, tmp_path, ground=ground if result.ground else None, manifest=SETTINGS)
    for place in (tmp_path, tmp_path / "check.json"):
        found, record = read_check(place)
        np.testing.assert_equal(asdict(found), asdict(result))
        assert record["settings"] == SETTINGS["settings"]


@pytest.mark.parametrize(
    "damage",
    [
        lambda record: record.pop("stretches"),
        lambda record: record["stretches"]["c_r"].pop(),
        lambda record: record["stretches"]["drive"].__setitem__(0, 9),
        lambda record: record["map"].update(class_limits=[0.1]),
        lambda record: record["stretches"]["measured"].__setitem__(0, float("1e308")),
        lambda record: record.update(warnings="off"),
    ],
)
def test_a_damaged_record_is_refused(ground, tmp_path, damage):
    write_check(made_up_check(), tmp_path, ground=ground)
    path = tmp_path / "check.json"
    record = json.loads(path.read_text())
    damage(record)
    path.write_text(json.dumps(record))
    with pytest.raises(BadInputError, match=r"check\.json.*Give the folder that `bumpymap check` wrote"):
        read_check(tmp_path)


@pytest.mark.parametrize("content", [b"[]", b"[" * 100_000, b"\xff"])
def test_a_file_that_is_no_check(tmp_path, content):
    (tmp_path / "check.json").write_bytes(content)
    with pytest.raises(BadInputError, match=r"check\.json"):
        read_check(tmp_path)
