"""The whole check over the layers of a small survey: readings by stretch and tile, and what is refused."""

import html
from dataclasses import replace
from pathlib import Path

import made_drives
import numpy as np
import pytest
from click.testing import CliRunner
from route_maps import bare_map

from bumpymap.check import check_drives
from bumpymap.check.places import places_on_map
from bumpymap.cli import main
from bumpymap.core import BadInputError, PlaceTrack
from bumpymap.layers.check_record import read_check
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


def test_positions_of_the_map_s_crs_are_taken():
    places = places_on_map(placed("projected"), SITE)
    assert places.place.real.min() > 40


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
