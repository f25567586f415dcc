"""Drives: the ground under them, what is measured of one, over how many starts, and in which processes."""

import math
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from bumpymap.core import BumpymapError, SilentProgress, UsageError
from bumpymap.lab.settings import DriveSettings, Physics
from bumpymap.lab.simulate.drive import follow
from bumpymap.lab.simulate.jobs import drive_jobs
from bumpymap.lab.simulate.model import PatchGround, Pose, Strip, strip_triangles
from bumpymap.rating.vehicle_profile import Vehicle

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
