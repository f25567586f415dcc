"""Drives whose pitch, way, clock, mounting and noise are known: what is measured is held against what was put in."""

from dataclasses import replace

import made_drives
import numpy as np
import pytest

from bumpymap.check.measure import measure_drive
from bumpymap.check.places import metre_places
from bumpymap.check.stretches import cut_stretches
from bumpymap.core import BadInputError, ImuTrack, WheelTrack


def measured(log):
    places = None if log.places is None else metre_places(log.places, log.places.x, log.places.y, log.name)
    found = measure_drive(log, places, 10.0)
    return found, cut_stretches(found, 10.0)


def true_c_r(log, cut, pitch_rate, way):
    step = log.imu.time[1] - log.imu.time[0]
    turned = np.concatenate([[0.0], np.cumsum(np.abs(pitch_rate)) * step])
    at = np.append(log.imu.time, log.imu.time[-1] + step)
    whole = np.append(way, way[-1])
    return (np.interp(cut.end_s, at, turned) - np.interp(cut.start_s, at, turned)) / (
        np.interp(cut.end_s, at, whole) - np.interp(cut.start_s, at, whole)
    )


@pytest.fixture(scope="module")
def good():
    made = made_drives.MadeDrive(
        offset=0.31,
        mount_deg=(3.0, -4.0, 5.0),
        noise=0.01,
        bias=0.01,
        place_white=0.015,
        place_wander=0.01,
        seconds=150.0,
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


def test_noise_of_positions_does_not_lengthen_the_way():
    log, _, way = made_drives.log_of(made_drives.MadeDrive(noise=0.01, place_white=0.25, place_wander=1.5, seed=5))
    found, cut = measured(log)
    assert np.abs(found.speed).sum() / found.hertz == pytest.approx(way[-1], rel=0.06)
    assert 0.5 < found.track.scatter.wander_m < 4.0
    assert (cut.measured_sd > 0.02 * cut.measured).all()


def test_a_sensor_upside_down_reads_the_same(good):
    made = replace(good[0], mount_deg=(180.0, 0.0, 0.0), seconds=90.0)
    log, pitch_rate, way = made_drives.log_of(made)
    found, cut = measured(log)
    assert abs(found.mount_deg[0]) == pytest.approx(180.0, abs=1.0)
    true = true_c_r(log, cut, pitch_rate, way)
    assert np.median(np.abs(cut.measured / true - 1.0)) < 0.03


def test_without_positions_the_way_is_that_of_the_wheels(good):
    _, log, pitch_rate, way, _, _ = good
    speed = np.gradient(way, log.imu.time)
    wheels = WheelTrack(log.imu.time[::5], speed[::5], np.full(len(speed[::5]), np.nan))
    found, cut = measured(replace(log, places=None, wheels=wheels))
    assert np.isnan(found.clock_offset_s)
    assert np.abs(found.speed).sum() / found.hertz == pytest.approx(way[-1], rel=0.02)
    assert np.median(np.abs(cut.measured / true_c_r(log, cut, pitch_rate, way) - 1.0)) < 0.04


def test_the_same_drive_gives_the_same_bits():
    log, _, _ = made_drives.log_of(made_drives.MadeDrive(seconds=40.0, noise=0.01, place_white=0.015))
    (found, cut), (again, cut_again) = measured(log), measured(log)
    assert np.array_equal(found.pitch_rate, again.pitch_rate)
    assert np.array_equal(cut.measured, cut_again.measured)


def test_a_gap_of_the_imu_does_not_count(good):
    _, log, _, _, _, _ = good
    keep = (log.imu.time < 60.0) | (log.imu.time > 64.0)
    imu = ImuTrack(log.imu.time[keep], log.imu.rate[keep], log.imu.acceleration[keep])
    found, cut = measured(replace(log, imu=imu))
    inside = (found.time > 60.1) & (found.time < 63.9)
    assert (found.reason[inside] == 1).all()
    assert (cut.label[inside] == -1).all()


def test_a_drive_without_accelerometer_is_measured_and_says_so(good):
    _, log, _, _, _, _ = good
    imu = replace(log.imu, acceleration=np.full_like(log.imu.acceleration, np.nan))
    found, _ = measured(replace(log, imu=imu))
    assert np.isnan(found.mount_deg).all()
    assert any("no accelerometer" in note for note in found.notes)


def few_positions(log):
    return replace(log.places, **{name: getattr(log.places, name)[:5] for name in ("time", "x", "y", "error")})


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda log: {"imu": ImuTrack(log.imu.time[::5], log.imu.rate[::5], log.imu.acceleration[::5])}, "`band_hz`"),
        (lambda log: {"imu": replace(log.imu, rate=np.degrees(log.imu.rate))}, "degrees per second"),
        (lambda log: {"imu": replace(log.imu, rate=np.radians(log.imu.rate))}, "radians per second"),
        (lambda log: {"places": replace(log.places, time=log.places.time + 1e6)}, "in common"),
        (lambda _: {"places": None}, "neither positions nor wheel speeds"),
        (lambda log: {"places": few_positions(log)}, "5 usable positions"),
    ],
    ids=["slow IMU", "degrees", "radians", "other clock", "no way", "few positions"],
)
def test_a_log_that_cannot_be_measured_is_refused(good, damage, told):
    log = good[1]
    with pytest.raises(BadInputError, match=told):
        measured(replace(log, **damage(log)))


def test_a_parked_vehicle_is_refused():
    log, _, _ = made_drives.log_of(made_drives.MadeDrive(speed=0.0, noise=0.01, place_white=0.02, seconds=30.0))
    with pytest.raises(BadInputError, match="never drives"):
        measured(log)


def test_a_short_way_tells_no_offset_of_the_clocks():
    log, _, _ = made_drives.log_of(made_drives.MadeDrive(seconds=32.0, offset=0.3, noise=0.01, place_white=0.015))
    found, _ = measured(log)
    assert np.abs(found.speed).sum() / found.hertz < 20.0
    assert np.isnan(found.clock_offset_s)


def test_positions_of_metres_tell_no_offset_or_state_its_error():
    made = made_drives.MadeDrive(offset=0.31, noise=0.01, place_white=0.25, place_wander=1.5, turning=0.3, seed=3)
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
