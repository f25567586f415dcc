"""Drives over ground for which C_r is known, at half the time step, and again in another process."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from known_grounds import PlaneGround, SineGround, sine_c_r

from bumpymap.lab.simulate.drive import DriveSettings, Start, drive, drive_from
from bumpymap.lab.simulate.jobs import run_in_processes
from bumpymap.lab.simulate.terrain import PatchGround
from bumpymap.rating import load_profile, make_textures

pytestmark = pytest.mark.slow

pytest.importorskip("dartpy")
WARTHOG = load_profile("warthog")
SHORT = DriveSettings(measure_s=5.0)


@pytest.mark.parametrize(("degrees", "heading"), [(0, 0), (30, 0), (30, 90)])
def test_planes_shake_nothing(degrees, heading):
    plane = PlaneGround((math.tan(math.radians(degrees)), 0.0))
    assert drive_from(WARTHOG, plane, Start(0.0, 0.0, math.radians(heading)), SHORT).c_r < 0.001


@pytest.mark.parametrize("wavelength", [2.0, 2.5, 5.0])
def test_sine_meets_its_closed_form(wavelength):
    made = drive_from(WARTHOG, SineGround(0.02, wavelength), Start(0.0, 0.0, 0.0), SHORT)
    assert made.c_r == pytest.approx(sine_c_r(WARTHOG, 0.02, wavelength), rel=0.05)


def rough(seed):
    patch = make_textures("high_noise", 1, np.random.default_rng(seed))[0].astype(np.float64)
    return PatchGround.from_heights(patch * 0.3, 3.0)


@pytest.mark.later
def test_half_the_time_step_changes_little():
    physics = SHORT.physics
    finer = replace(SHORT, physics=replace(physics, time_step=physics.time_step / 2))
    c_r = np.array([[drive(WARTHOG, rough(n), n, chosen).c_r for chosen in (SHORT, finer)] for n in range(6)])
    coarse, fine = c_r[np.isfinite(c_r).all(axis=1)].sum(axis=0)
    assert fine == pytest.approx(coarse, rel=0.03)


@pytest.mark.later
def test_same_seed_gives_the_same_bits_in_another_process():
    run = partial(drive, WARTHOG, rough(3), settings=SHORT)
    assert [run(3), *run_in_processes(run, [3], 1)] == [run(3)] * 2
