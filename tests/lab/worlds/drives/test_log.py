"""Faults of simulated sensors against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pyproj import Transformer
from scipy.signal import butter, sosfiltfilt, welch
from sensed_drives import (
    GNSS,
    GRAVITY,
    IMUS,
    ClockFault,
    DriveSensors,
    GnssGrade,
    SensorGrade,
    Vibration,
    band_noise,
    mount_rotation,
    sense_drive,
    sense_places,
    slow_noise,
    write_drive_files,
)

PERFECT = DriveSensors(IMUS["perfect"], GNSS["perfect"], vibration=None)
NONE = SensorGrade(0, 0, 0, 0, 0, 0)


def sensed(drive, seed=1, **faults):
    return sense_drive(drive, replace(PERFECT, **faults), seed)


def test_perfect_sensors_read_the_motion(circle):
    drive = circle(speed=1.5, turn=0.3, pitch_rate=0.2)
    found = sensed(drive)
    imu, places = found.log.imu, found.log.places
    assert imu.rate == pytest.approx(np.tile([0, 0.2, 0.3], (len(imu.time), 1)), abs=1e-9)
    assert imu.acceleration[5:-5] == pytest.approx(np.tile([0, 0.45, GRAVITY], (len(imu.time) - 10, 1)), abs=1e-4)
    at = places.time - found.start_s
    assert places.x == pytest.approx(np.interp(at, drive.time, drive.place[:, 0]), abs=1e-3)
    assert places.y == pytest.approx(np.interp(at, drive.time, drive.place[:, 1]), abs=1e-3)
    assert np.median(np.diff(imu.time)) == pytest.approx(0.01, abs=1e-5)
    assert np.median(np.diff(places.time)) == pytest.approx(0.1, abs=1e-5)


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not(standing):
    sensors = DriveSensors(IMUS["cheap"], GNSS["single"])
    first, again, other = (sense_drive(standing(), sensors, seed).log for seed in (3, 3, 4))
    assert (first.imu.rate == again.imu.rate).all()
    assert (first.places.x == again.places.x).all()
    assert (first.imu.rate[:1000] != other.imu.rate[:1000]).mean() > 0.9


@pytest.mark.parametrize("rate_hz", [100.0, 200.0])
def test_noise_has_its_density_at_any_sampling_rate(standing, rate_hz):
    grade = replace(IMUS["perfect"], rate=replace(NONE, noise=2e-4), sample_hz=rate_hz)
    rate = sensed(standing(60.0), imu=grade).log.imu.rate
    assert rate.std(axis=0) == pytest.approx(2e-4 * math.sqrt(rate_hz / 2), rel=0.03)
    _, density = welch(rate, rate_hz, nperseg=256, axis=0)
    assert np.sqrt(density[5:-5].mean(axis=0)) == pytest.approx(2e-4, rel=0.03)


def test_a_mounting_is_a_rotation(circle, standing):
    drive = circle(speed=1.5, turn=0.3, pitch_rate=0.2)
    plain, turned = sensed(drive).log.imu, sensed(drive, mount_deg=(3.0, -5.0, 4.0)).log.imu
    back = mount_rotation((3.0, -5.0, 4.0))
    assert turned.rate @ back.T == pytest.approx(plain.rate)
    assert turned.acceleration @ back.T == pytest.approx(plain.acceleration)
    # A sensor whose nose points down by 5 degrees feels gravity along its negative forward axis.
    felt = sensed(standing(), mount_deg=(0.0, 5.0, 0.0)).log.imu.acceleration.mean(axis=0)
    assert felt == pytest.approx([-GRAVITY * math.sin(math.radians(5)), 0, GRAVITY * math.cos(math.radians(5))])


def test_clock_and_latency_are_in_the_offset_that_has_to_be_found(circle):
    drive = circle(speed=2.0, turn=0.0, seconds=100.0)
    found = sensed(drive, gnss=GnssGrade(0.0, 0.0, latency_s=0.1), clock=ClockFault(0.4, 50.0))
    places, truth = found.log.places, found.truth
    assert truth.clock_offset_s == pytest.approx(0.3)
    shown = places.time - found.start_s
    true = (places.x - 480_000.0) / 2.0
    drift = truth.clock_drift_ppm * 1e-6 * (true - 50.0)
    assert shown + truth.clock_offset_s + drift == pytest.approx(true, abs=1e-5)


def test_the_filter_of_the_imu_delays_slow_motion_by_what_the_truth_says(circle):
    drive = circle(speed=1.0, turn=0.0, seconds=60.0)
    waving = replace(drive, rates=np.sin(2 * np.pi * 0.5 * drive.time)[:, None] * np.ones(3))
    found = sensed(waving, imu=replace(IMUS["perfect"], cutoff_hz=20.0))
    at = found.log.imu.time - found.start_s - found.truth.clock_offset_s
    assert found.truth.clock_offset_s == pytest.approx(0.01125, abs=1e-5)
    assert found.log.imu.rate[200:, 1] == pytest.approx(np.sin(np.pi * at[200:]), abs=2e-3)


def test_dropouts_leave_gaps_and_nothing_else(standing):
    gnss = GnssGrade(0.0, 0.0, gaps=1)
    lengths = []
    for seed in range(6):
        apart = np.diff(sensed(standing(120.0), seed, gnss=gnss).log.places.time)
        assert np.sort(apart)[:-1] == pytest.approx(0.1, abs=1e-5)
        lengths.append(apart.max())
    assert 2.0 < min(lengths) < max(lengths) <= 20.2


def test_errors_of_positions_have_their_size_and_are_forgotten(standing):
    gnss = GnssGrade(white_m=0.2, slow_m=1.0, slow_s=20.0)
    drive = standing(400.0)
    places = [sense_places(drive, PERFECT, gnss, np.random.default_rng(seed)) for seed in range(20)]
    errors = np.stack([place.x[:3990] - 480_000.0 for place in places])
    assert errors.std() == pytest.approx(math.hypot(0.2, 1.0), rel=0.15)
    assert np.diff(errors).std() == pytest.approx(math.sqrt(2) * 0.2 + 0.03, rel=0.15)
    later = (errors[:, 200:] * errors[:, :-200]).mean() / errors.var()
    assert later == pytest.approx(math.exp(-1), abs=0.15)
    assert places[0].error == pytest.approx(gnss.error_m)


def test_series_have_their_variance_band_and_memory():
    rng = np.random.default_rng(1)
    noise = band_noise(rng, (100_000, 2), (15.0, 60.0), 500.0)
    assert noise.std(axis=0) == pytest.approx(1.0, abs=0.03)
    f, density = welch(noise[:, 0], 500.0, nperseg=1024)
    assert density[(f > 14) & (f < 65)].sum() / density.sum() > 0.85
    assert density[f < 10].sum() / density.sum() < 0.02
    slow = slow_noise(rng, (400_000, 1), 2.0, 10.0)[:, 0]
    assert slow.std() == pytest.approx(1.0, abs=0.05)
    assert np.corrcoef(slow[20:], slow[:-20])[0, 1] == pytest.approx(math.exp(-1), abs=0.03)


def test_vibration_follows_the_speed_and_leaves_the_band_below_10_hz_alone(circle):
    shaken = Vibration(idle_rate=(0.0, 0.0, 0.0), idle_acceleration=(0.0, 0.0, 0.0))
    for speed, share in ((2.0, 1.0), (0.5, 0.5), (0.0, 0.0)):
        drive = circle(speed=speed, turn=0.0)
        imu = sensed(drive, vibration=replace(shaken, tone_per_m=60.0), imu=replace(IMUS["perfect"], sample_hz=200.0))
        wy = imu.log.imu.rate[:, 1]
        assert wy.std() == pytest.approx(0.008 * share, rel=0.1, abs=1e-9)
        low = sosfiltfilt(butter(4, 10.0, fs=200.0, output="sos"), wy)
        assert low.std() <= 0.15 * wy.std()


def test_the_true_floor_is_what_a_standing_vehicle_reads(standing):
    found = sense_drive(standing(100.0), DriveSensors(IMUS["good"], None), 5)
    wy = found.log.imu.rate[:, 1]
    low = sosfiltfilt(butter(4, 10.0, fs=200.0, output="sos"), wy - wy.mean())
    assert found.truth.floor_radps == pytest.approx(np.abs(low).mean(), rel=0.02)
    assert 0.003 < found.truth.floor_radps < 0.02
    assert found.log.places is None
    assert math.isnan(found.truth.position_error_m)


def test_readings_are_whole_steps(standing):
    grade = replace(IMUS["perfect"], rate=replace(NONE, noise=1e-3, step=0.01))
    rate = sensed(standing(), imu=grade).log.imu.rate
    assert rate / 0.01 == pytest.approx(np.round(rate / 0.01))
    assert np.unique(rate).size > 2


def test_scale_and_cross_axis_errors_mix_the_axes(circle):
    grade = replace(IMUS["perfect"], rate=replace(NONE, scale=0.01, cross=0.007))
    drive = circle(speed=1.0, turn=0.0, seconds=2.0, pitch_rate=1.0)
    rates = np.stack([sensed(drive, seed, imu=grade).log.imu.rate[0] for seed in range(100)])
    assert rates.std(axis=0) == pytest.approx([0.007, 0.01, 0.007], rel=0.25)
    assert rates.mean(axis=0) == pytest.approx([0, 1, 0], abs=0.003)


def test_longitude_and_latitude_are_those_of_the_crs(standing):
    log = sense_drive(standing(), PERFECT, 1, crs="EPSG:32614").log
    assert log.places.kind == "lonlat"
    back = Transformer.from_crs("EPSG:4326", "EPSG:32614", always_xy=True).transform(log.places.x[0], log.places.y[0])
    assert back == pytest.approx((480_000.0, 2_136_000.0), abs=1e-3)


def test_files_hold_the_log(circle, tmp_path):
    drive = circle(speed=1.0, turn=0.5)
    log = sense_drive(drive, replace(PERFECT, wheels_hz=20.0), 1, "lap", "EPSG:32614").log
    imu, gnss, wheels = write_drive_files(log, tmp_path)
    assert [path.name for path in (imu, gnss, wheels)] == ["lap_imu.csv", "lap_gnss.csv", "lap_wheels.csv"]
    assert imu.read_text().startswith("time [s],gyro_x [rad/s],")
    held = np.loadtxt(imu, delimiter=",", skiprows=1)
    assert held[:, 1:4] == pytest.approx(log.imu.rate, abs=1e-6)
    assert held[:, 0] == pytest.approx(log.imu.time, abs=1e-6)
    held = np.loadtxt(gnss, delimiter=",", skiprows=1)
    assert held[:, 1] == pytest.approx(log.places.x, abs=1e-9)
    held = np.loadtxt(wheels, delimiter=",", skiprows=1)
    assert held[:, 1:] == pytest.approx(np.tile([0.75, 1.25], (len(held), 1)))
