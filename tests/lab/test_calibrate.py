"""Drives, over which starts and in which processes, and the calibrations that are made of them and fitted again."""

import errno
import json
import math
import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from bumpymap.core import BumpymapError, OutputError, SilentProgress, UsageError
from bumpymap.lab.settings import CalibrationSettings, DriveSettings, Physics
from bumpymap.lab.simulate import calibrate, refit as refit_module
from bumpymap.lab.simulate.drive import PatchDrives, calibrated_settings, follow
from bumpymap.lab.simulate.jobs import DriveJob, drive_jobs
from bumpymap.lab.simulate.model import PatchGround, Pose, Strip, strip_triangles
from bumpymap.lab.simulate.motion_fit import SPEED_RATIOS, fit_means, motion_jobs
from bumpymap.lab.simulate.refit import run_crossing
from bumpymap.lab.terrains import KINDS
from bumpymap.rating import Calibration, Correction, Vehicle, shipped_calibrations

CALIBRATED = Calibration.shipped("warthog")
SHORT = DriveSettings(settle_s=0.2, ramp_s=0.3, cruise_s=0.0, measure_s=0.6)
SETTINGS = CalibrationSettings(
    Vehicle.load("warthog"), 4, patches=2, starts=1, z_range=(0.05, 0.4), terrains=1, terrain_starts=2, drive=SHORT
)
TABLE, LIBRARY = 16, len(KINDS)


@given(st.lists(st.floats(0.001, 2.0), min_size=5, max_size=10, unique_by=lambda v: round(v, 4)))
def test_natural_breaks_are_the_best_of_all_splits(values):
    def spread(groups):
        return sum(((g - g.mean()) ** 2).sum() for g in groups)

    x = np.sort(values)
    limits = refit_module.natural_breaks(np.array(values), 4)
    found = spread(np.split(x, np.searchsorted(x, limits)))
    best = min(spread(np.split(x, cuts)) for cuts in combinations(range(1, len(x)), 3))
    assert found == pytest.approx(best, rel=1e-9, abs=1e-12)


def test_a_calibration_to_fit_again_that_cannot_be_read_is_named(tmp_path):
    command = [sys.executable, "-m", "bumpymap.lab.simulate.refit", str(tmp_path / "none.json")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr.startswith(f"Error: cannot read the calibration {tmp_path}")


def test_failed_drives_count_in_p_fail_and_not_in_c_r(monkeypatch):
    def drives(*c_r):
        return PatchDrives(tuple("completed" if c is not None else "rolled" for c in c_r), c_r)

    # C_r grows by texture and z range; patches differ. In the last cell, three of six drives failed.
    cells = {(t, z): [drives(0.02 * 2**t * (1 + 4 * z) * f) for f in (0.8, 1, 1.2)] for t in range(4) for z in (0, 1)}
    cells[3, 1] = [drives(0.5, None), drives(None, None), drives(1.5, 2.5)]
    results = {("table", *place, patch): d for place, cell in cells.items() for patch, d in enumerate(cell)}
    library = [("library", kind, index) for kind in KINDS for index in range(4)]
    results |= {name: drives(0.01 * (1 + i)) for i, name in enumerate(library)}
    settings = CalibrationSettings(Vehicle.load("warthog"), patches=3, starts=2, z_range=(0.1, 1.0), terrains=4)
    monkeypatch.setattr(calibrate, "fit_models", no_models)
    calibration = calibrate.summarise(settings, results)
    assert calibration.p_fail[3][1] == pytest.approx(3 / 6)
    assert calibration.c_r[3][1] == pytest.approx((0.5 + 2.0) / 2)
    assert calibration.c_r_log_sd[3][1] == pytest.approx(math.log(4) / math.sqrt(2))


def test_limits_are_the_mean_of_the_breaks_of_what_can_be_crossed_and_the_roughest_hardly_move_them():
    libraries = np.array([np.repeat((0.1, 0.3, 0.6, 1.0), 10), np.repeat((0.2, 0.4, 0.7, 1.1), 10)])
    none = np.zeros_like(libraries)
    assert refit_module.class_limits(libraries, none) == pytest.approx((0.25, 0.5, 0.85))
    lost = (
        np.concatenate((libraries, np.full((2, 9), 5.0)), axis=1),
        np.concatenate((none, np.full((2, 9), 0.6)), axis=1),
    )
    assert refit_module.class_limits(*lost) == pytest.approx((0.25, 0.5, 0.85))
    libraries[:, -2:] = 30.0  # two of forty
    assert refit_module.class_limits(libraries, none) == pytest.approx((0.25, 0.5, 0.85))


def test_vehicle_that_fails_everywhere_and_limits_too_close_together_are_refused():
    c_r = np.tile(np.linspace(0.1, 0.9, 9), (2, 1))
    with pytest.raises(BumpymapError, match="crosses 3 of 9 terrains"):
        refit_module.class_limits(c_r, np.where(c_r > 0.35, 0.9, 0.0))
    with pytest.raises(BumpymapError, match="too close together"):
        refit_module.class_limits(1e-4 * c_r, 0 * c_r)


def no_models(*_):
    return {"class_limits": (0.1, 0.2, 0.4), "class_c_r": (0.05, 0.15, 0.3, 0.6), "ride": {}, "thin": {}}, {}


@pytest.fixture(scope="module")
def without_fits():
    """Only table and library: no crossings, no other speeds, no models."""
    pytest.importorskip("dartpy")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibrate, "fit_models", no_models)
        patch.setattr(calibrate, "fit_steps", lambda *_: {})
        patch.setattr(calibrate, "fit_motion", lambda *_: SimpleNamespace(to_record=dict))
        for name in ("crossing_jobs", "motion_jobs"):
            patch.setattr(calibrate, name, lambda _: [])
        yield


@pytest.fixture(scope="module")
def calibration(without_fits):
    return calibrate.calibrate_vehicle(SETTINGS)


@pytest.fixture
def fake_drives(without_fits, monkeypatch):
    """Jobs that cost nothing; returns the list of those that ran."""
    ran = []

    def run(settings, job):
        ran.append(job)
        kind = job.key[1]
        c_r = 0.03 * (1 + kind) if job.key[0] == "table" else 0.01 * (1 + KINDS.index(kind))
        return PatchDrives(("completed",) * job.starts, (c_r,) * job.starts)

    monkeypatch.setattr(calibrate, "run_job", run)
    return ran


@pytest.mark.slow
def test_real_calibration_rises_with_z_range_and_reads_back(calibration):
    assert all(low < high for low, high in calibration.c_r)
    assert calibration.drives == ((2, 2),) * 4
    assert calibration.ride == {}
    assert Calibration.from_json(calibration.to_json(), "x") == calibration


def test_classes_mean_the_same_for_tiles_of_another_size(monkeypatch):
    monkeypatch.setattr(refit_module, "_TERRAINS", 4)
    own = Calibration.shipped("warthog", tile_size=5.0)
    ride, like = Correction.from_record(own.ride), replace(CALIBRATED, class_limits=(0.05, 0.09, 0.13))
    found, said = refit_module.fit_classes(calibrated_settings(own), ride, [ride, ride], like)
    assert found["class_limits"] == like.class_limits
    assert like.id in said["class_rule"]
    edges = (0.0, *like.class_limits, np.inf)
    assert all(low < mean < high for mean, low, high in zip(found["class_c_r"], edges, edges[1:], strict=False))
    assert said["relative_standard_errors"] == {"c_r": 0.0}


@pytest.mark.later
def test_number_of_workers_changes_nothing(calibration):
    assert calibrate.calibrate_vehicle(SETTINGS, workers=2) == calibration


def test_interruption_changes_nothing_and_driven_patches_are_not_driven_again(fake_drives, tmp_path):
    path, whole = tmp_path / "out.json.progress.jsonl", calibrate.calibrate_vehicle(SETTINGS)

    class Stop(SilentProgress):
        done = 0

        def advance(self, steps):
            self.done += steps
            if self.done >= TABLE + 6:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        calibrate.calibrate_vehicle(SETTINGS, Stop(), journal=calibrate.calibration_journal(path, SETTINGS))
    assert len(path.read_text().splitlines()) == 1 + TABLE + 3
    fake_drives.clear()
    assert calibrate.calibrate_vehicle(SETTINGS, journal=calibrate.calibration_journal(path, SETTINGS)) == whole
    assert len(fake_drives) == LIBRARY - 3


@pytest.mark.slow
def test_job_depends_on_nothing_but_the_settings(calibration):
    more = replace(SETTINGS, patches=5, starts=2, terrains=3, terrain_starts=3)
    table, library = DriveJob(("table", 3, 1, 1), 1), DriveJob(("library", "furrows", 0), 2)
    assert calibrate.run_job(more, replace(table, starts=2)).c_r[:1] == calibrate.run_job(SETTINGS, table).c_r
    assert calibration.settings["patch_c_r"][3][1][1] == calibrate.run_job(SETTINGS, table).c_r[0]
    made = calibrate.run_job(SETTINGS, library)
    assert calibrate.run_job(more, replace(library, starts=3)).c_r[:2] == made.c_r
    assert calibration.settings["library"]["furrows"]["c_r"] == [pytest.approx(made.mean_c_r, rel=1e-5)]


DRIVEN = {("a", 1): PatchDrives(("completed",), (0.1,)), ("b", 2): PatchDrives(("rolled",), (None,))}


@pytest.fixture
def progress(tmp_path):
    """A progress file that holds ``DRIVEN``."""
    journal = calibrate.calibration_journal(tmp_path / "progress", SETTINGS)
    assert journal.resume(discard_other=False) == {}
    for key, drives in DRIVEN.items():
        journal.add(key, drives)
    return tmp_path / "progress"


def resume(path, settings=SETTINGS, *, discard_other=False):
    return calibrate.calibration_journal(path, settings).resume(discard_other=discard_other)


def test_cut_off_line_is_dropped(progress, caplog):
    lines = progress.read_text().splitlines()
    progress.write_text("\n".join(lines)[:-9])
    assert resume(progress) == {("a", 1): DRIVEN["a", 1]}
    assert "damaged line" in caplog.text
    assert progress.read_text().splitlines() == lines[:2]


def test_progress_of_other_settings_is_refused_unless_told(progress):
    other = replace(SETTINGS, seed=5)
    with pytest.raises(OutputError, match=r"other settings.*--overwrite"):
        resume(progress, other)
    assert resume(progress) == DRIVEN
    assert resume(progress, other, discard_other=True) == {}
    (header,) = progress.read_text().splitlines()
    assert json.loads(header)["settings"]["seed"] == 5


@pytest.mark.parametrize("target", ["mine", "none"])
def test_a_progress_file_that_is_a_link_or_became_one_during_the_run_is_left_alone(tmp_path, target):
    path, mine = tmp_path / "progress", tmp_path / "mine"
    mine.write_text("mine")
    journal = calibrate.calibration_journal(path, SETTINGS)
    journal.resume(discard_other=False)
    path.unlink()
    path.symlink_to(tmp_path / target)
    for touch in (lambda: resume(path, discard_other=True), lambda: journal.add(("a", 1), DRIVEN["a", 1])):
        with pytest.raises(OutputError, match="is a link and was not touched"):
            touch()
    assert sorted(found.name for found in tmp_path.iterdir()) == ["mine", "progress"]
    assert mine.read_text() == "mine"


def test_a_full_disk_does_not_cost_what_was_driven(progress, monkeypatch):
    def full(file, *_, **__):
        file.touch()
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("pathlib.Path.write_text", full)
        with pytest.raises(OutputError, match="No space left"):
            resume(progress)
    assert resume(progress) == DRIVEN


@pytest.mark.later
@pytest.mark.parametrize("name", shipped_calibrations())
def test_shipped_calibration_is_what_this_code_makes(name):
    pytest.importorskip("dartpy")
    shipped = Calibration.shipped(name)
    made = shipped.settings
    profile = Vehicle.load(name)
    assert Vehicle.from_dict(shipped.vehicle, name) == profile
    settings = CalibrationSettings(
        profile, **{name: made[name] for name in ("seed", "patches", "starts", "terrains", "terrain_starts")}
    )
    wanted = {name: value for name, value in settings.to_dict().items() if name not in ("versions", "vehicle")}
    assert {name: made[name] for name in wanted} == wanted
    for texture, z in ((0, 5), (3, 2)):
        drives = calibrate.run_job(settings, DriveJob(("table", texture, z, 0), settings.starts))
        assert drives.mean_c_r == pytest.approx(made["patch_c_r"][texture][z][0], rel=0.01)
    drives = calibrate.run_job(settings, DriveJob(("library", "fractal_5", 1), settings.terrain_starts))
    assert drives.mean_c_r == pytest.approx(made["library"]["fractal_5"]["c_r"][1], rel=0.01)


@pytest.mark.later
def test_shipped_class_limits_follow_from_the_shipped_ride_model():
    ride = Correction.from_record(CALIBRATED.ride)
    found, said = refit_module.fit_classes(calibrated_settings(CALIBRATED), ride, [ride], None)
    assert found["class_limits"] == pytest.approx(CALIBRATED.class_limits, rel=0.006)  # of three digits
    assert found["class_c_r"] == pytest.approx(CALIBRATED.class_c_r, rel=1e-3)
    assert said["class_rule"] == CALIBRATED.settings["class_rule"]


@pytest.mark.parametrize("name", shipped_calibrations())
def test_shipped_classes_are_sure_and_the_same_for_tiles_of_every_size_and_cells_follow_from_their_drives(name):
    shipped = Calibration.shipped(name)
    assert max(shipped.settings["relative_standard_errors"]["class_limits"]) < 0.07
    for size in (5.0, 6.0):
        assert Calibration.shipped(name, tile_size=size).class_limits == shipped.class_limits
    means = [
        [np.mean([c for c in cell if c is not None] or np.nan) for cell in z] for z in shipped.settings["patch_c_r"]
    ]
    np.testing.assert_allclose(np.array(shipped.c_r, dtype=float), means, rtol=1e-12)


@pytest.mark.parametrize(("spread", "tolerance"), [(0.0, 1e-3), (0.1, 0.1)])
def test_it_finds_what_was_put_in_and_its_spread_and_leaves_failed_terrains_out(spread, tolerance):
    settings = replace(calibrated_settings(CALIBRATED), terrains=8, terrain_starts=4)
    # Logarithms are plain functions of C_r and speed, with errors of that spread.
    c_r = np.geomspace(0.01, 0.4, len(motion_jobs(settings)))[:, None]
    s = np.log(SPEED_RATIOS)[None, :]
    logs = np.stack([np.log(c_r) - 0.1 * s, np.log(4 * c_r) + 1.3 * s], axis=-1)
    errors = np.random.default_rng(1).normal(0.0, spread, logs.shape)
    errors[:, SPEED_RATIOS.index(1.0), 0] = 0.0
    means = np.exp(logs + errors)
    means[3, 2] = np.nan
    model = fit_means(settings, means, 2)
    told = np.exp(model.plain_log_factors(np.array([0.03, 0.1, 0.3]), np.log((0.5, 1.0, 1.5))))
    for speed, ratio in enumerate((0.5, 1.0, 1.5)):
        assert told[:, speed] == pytest.approx(np.tile([ratio**-0.1, 4 * ratio**1.3], (3, 1)), rel=tolerance)
    assert model.origin["used"] == len(means) - 1
    for fit in (model.c_r, model.a_w):
        assert fit.plain_log_sd == pytest.approx(spread, rel=0.3, abs=1e-3)


@pytest.mark.later
@pytest.mark.parametrize("name", shipped_calibrations())
def test_the_shipped_record_is_what_its_drives_give(name):
    shipped = Calibration.shipped(name)
    origin = shipped.motion["origin"]
    made = fit_means(calibrated_settings(shipped), np.array(origin["driven"], np.float64), origin["starts"]).to_record()
    for key in ("c_r", "a_w"):
        assert made[key]["plain"] == pytest.approx(shipped.motion[key]["plain"], rel=1e-4, abs=1e-5)
        assert made[key]["log_sd"] == pytest.approx(shipped.motion[key]["log_sd"], rel=0.01)
    assert made["origin"] == shipped.motion["origin"]


def test_limits_of_tiles_of_another_size_stay_when_it_is_fitted_again(monkeypatch):
    def models(_settings, _driven, like):
        return {"class_limits": like.class_limits}, {"class_rule": "another"}

    monkeypatch.setattr(refit_module, "fit_models", models)
    own = Calibration.shipped("warthog", tile_size=5.0)
    made = refit_module.refit(own)
    assert (made.class_limits, made.settings["class_rule"]) == (own.class_limits, own.settings["class_rule"])


def test_a_calibration_that_was_moved_to_real_drives_or_lacks_the_library_is_refused():
    settings = CALIBRATED.settings | {"moved_to_drives": {"calibration_id": CALIBRATED.id}}
    with pytest.raises(UsageError, match=f"moved to real drives.*Fit the calibration {CALIBRATED.id}.*check --refit"):
        refit_module.refit(replace(CALIBRATED, settings=settings))
    settings = {key: value for key, value in CALIBRATED.settings.items() if key != "library"}
    with pytest.raises(UsageError, match="holds no drives over the terrain library"):
        refit_module.refit(replace(CALIBRATED, settings=settings))


@pytest.mark.later
def test_a_low_kerb_is_crossed_and_a_high_wall_is_not_and_a_crossing_is_that_of_the_shipped_calibration():
    pytest.importorskip("dartpy")
    settings = CalibrationSettings(Vehicle.load("warthog"))
    for up in (1, 0):
        assert run_crossing(settings, DriveJob(("crossing", "0.1", 0, up), 1)).outcome == ("completed",)
    assert run_crossing(settings, DriveJob(("crossing", "0.7", 1, 1), 1)).outcome == ("stuck",)
    record = CALIBRATED.steps["crossing"]
    failed = run_crossing(settings, DriveJob(("crossing", "0.4", 0, 1), 1)).failed
    assert failed == record["fail_up"][record["height"].index(0.4)][0]


SIZE = 3.0
HEIGHTS = np.random.default_rng(5).normal(0, 0.2, (15, 15)) + 7.0
WARTHOG = Vehicle.load("warthog")


def pixel_centres(pixels=15):
    axis = (np.arange(pixels) + 0.5) * SIZE / pixels
    return np.meshgrid(axis, axis[::-1])  # north row first


@pytest.fixture
def ground():
    return PatchGround.from_heights(HEIGHTS, SIZE)


def test_pixel_centres_keep_their_heights_north_up(ground):
    np.testing.assert_allclose(ground.height(*pixel_centres()), HEIGHTS, atol=1e-12)


@given(st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)), arrays(np.float64, (2, 20), elements=st.floats(-40, 40)))
def test_a_sloping_patch_goes_on_as_its_plane_and_not_as_a_ridge(slope, points):
    easting, northing = pixel_centres()
    ground = PatchGround.from_heights(slope[0] * easting + slope[1] * northing + 2, SIZE)
    expected = slope[0] * points[0] + slope[1] * points[1] + 2
    np.testing.assert_allclose(ground.height(*points), expected, atol=1e-9)


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_strip_is_covered_once_and_without_holes(ground, heading):
    triangles = strip_triangles(ground, Strip(2.0, 4.0, heading, 6.0, 1.0)).astype(float)
    a, b, c = triangles.transpose(1, 0, 2)
    area = np.cross(b - a, c - a)[:, 2] / 2  # above 0: every triangle faces up
    cells = np.floor(triangles.mean(axis=1)[:, :2] / ground.spacing + 1e-6).astype(int)
    unique, times = np.unique(cells, axis=0, return_counts=True)
    assert set(times) == {2}
    np.testing.assert_allclose(area, ground.spacing**2 / 2, rtol=1e-3)
    forward, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    along, across = np.meshgrid(np.linspace(-0.99, 6.99, 40), np.linspace(-0.99, 0.99, 20))
    inside = np.array([2.0, 4.0]) + along[..., None] * forward + across[..., None] * left
    wanted = np.floor(inside.reshape(-1, 2) / ground.spacing).astype(int)
    assert set(map(tuple, wanted)) <= set(map(tuple, unique))


STRIP = Strip(3.0, 4.0, 0.5, 10.0, 3.0)
MADE_UP = DriveSettings(settle_s=0.1, ramp_s=0.2, cruise_s=0.1, measure_s=2.0)


class KinematicVehicle:
    """Goes where its wheels push it, and pitches and tilts as it is told by functions of the time."""

    def __init__(self, pitch_rate=lambda _t: 0.0, tilt=lambda _t: 0.0, grip=lambda _t: 1.0, drift=0.0, beside=0.0):
        self.pitch_rate, self.tilt, self.grip, self.drift = pitch_rate, tilt, grip, drift
        self.time, self.heading = 0.0, STRIP.heading
        self.easting = STRIP.easting - beside * math.sin(STRIP.heading)
        self.northing = STRIP.northing + beside * math.cos(STRIP.heading)
        self.commands = []

    def command(self, left_mps, right_mps):
        self.commands.append((left_mps, right_mps))

    def advance(self, steps):
        seconds = steps * MADE_UP.physics.time_step
        self.time += seconds
        left, right = self.commands[-1]
        self.heading += (right - left) / WARTHOG.track_m * seconds
        speed = (left + right) / 2 * self.grip(self.time)
        self.easting += (speed * math.cos(self.heading) - self.drift * math.sin(STRIP.heading)) * seconds
        self.northing += (speed * math.sin(self.heading) + self.drift * math.cos(STRIP.heading)) * seconds

    def pose(self):
        return Pose(self.easting, self.northing, self.heading, self.tilt(self.time), self.pitch_rate(self.time))


def run(**motion):
    vehicle = KinematicVehicle(**motion)
    return vehicle, follow(vehicle, STRIP, WARTHOG, MADE_UP)


def test_c_r_is_the_pitch_per_metre():
    _, drive = run(pitch_rate=lambda _t: -0.25)
    assert drive.outcome == "completed"
    assert drive.c_r == pytest.approx(0.25, rel=1e-9)
    assert drive.path_m == pytest.approx(2.0, rel=1e-9)
    assert run(pitch_rate=lambda t: 9.0 if t < 0.399 else 0.0)[1].c_r == 0.0  # before the measurement
    _, aslant = run(pitch_rate=lambda _t: -0.25, beside=0.5)  # of the metres of its path, not of its line
    assert aslant.path_m == pytest.approx(2.0, rel=1e-6)
    assert aslant.c_r == pytest.approx(0.25, rel=1e-6)


@pytest.mark.parametrize(
    ("motion", "outcome"),
    [
        ({"grip": lambda _t: 0.19, "pitch_rate": lambda _t: 1.0}, "stuck"),  # less than a fifth of its way
        ({"grip": lambda _t: 0.21}, "completed"),
        ({"drift": 1.2}, "stuck"),  # off its line
        ({"tilt": lambda t: math.radians(61) if t > 1.5 else 0.0}, "rolled"),
        ({"tilt": lambda t: math.radians(61) if t < 0.05 else 0.0}, "rolled"),
        ({"tilt": lambda _t: math.radians(59)}, "completed"),
    ],
)
def test_a_vehicle_that_gets_nowhere_is_stuck_and_one_past_sixty_degrees_has_rolled_over(motion, outcome):
    _, drive = run(**motion)
    assert drive.outcome == outcome
    assert math.isnan(drive.c_r) == (outcome != "completed")


def test_time_step_must_divide_the_time_between_samples():
    with pytest.raises(UsageError, match=r"0\.003 s does not divide"):
        DriveSettings(physics=Physics(time_step=0.003))
    assert DriveSettings(physics=Physics(time_step=0.0005)).steps_per_sample == 20


JOBS = """
import os, time
from dataclasses import dataclass

@dataclass(frozen=True)
class Job:
    key: int
    starts: int = 1

def twice(job): return 2 * job.key
def die(job): os._exit(1)
def never(job):
    os.write(1, f"{os.getpid()}\\n".encode())  # in one piece: two workers write into one pipe
    time.sleep(3600)
"""


@pytest.fixture
def jobs(tmp_path, monkeypatch):
    """A module that workers can import."""
    (tmp_path / "pool_jobs.py").write_text(JOBS)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "pool_jobs", raising=False)
    return __import__("pool_jobs")


def test_results_come_in_order_and_the_process_has_no_thread_for_it(jobs):
    before, seen = threading.active_count(), []

    class Told(SilentProgress):
        def start(self, stage, total):
            seen.append((stage, total))

        def advance(self, steps):
            seen.append((steps, threading.active_count()))

    made = drive_jobs(jobs.twice, [jobs.Job(key) for key in range(7)], Told(), workers=3)
    assert list(made.items()) == [(key, 2 * key) for key in range(7)]
    assert seen == [("driving", 7), (0, before), *7 * [(1, before)]]


@pytest.mark.slow
def test_a_dead_worker_is_reported_with_what_to_do(jobs):
    with pytest.raises(BumpymapError, match="run the same command again"):
        drive_jobs(jobs.die, [jobs.Job(0), jobs.Job(1)], workers=2)


@pytest.mark.later
def test_workers_end_with_a_main_process_that_was_killed(jobs):
    code = (
        "from bumpymap.lab.simulate.jobs import drive_jobs\n"
        "import pool_jobs\n"
        "drive_jobs(pool_jobs.never, [pool_jobs.Job(0), pool_jobs.Job(1)], workers=2)\n"
    )
    paths = os.pathsep.join([str(Path(jobs.__file__).parent), *filter(None, sys.path)])
    pipe, environment = subprocess.PIPE, os.environ | {"PYTHONPATH": paths}
    main = subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=pipe, stderr=pipe, text=True)
    workers = {int(main.stdout.readline()) for _ in range(2)}
    assert main.pid not in workers
    for worker in workers:
        os.kill(worker, signal.SIGTERM)  # of the whole group: it is for the main process
    main.kill()
    # The workers hold the pipes too: their ends are reached only when all are gone.
    assert main.communicate(timeout=30) == ("", "")
