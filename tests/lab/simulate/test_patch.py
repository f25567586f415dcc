"""Patches driven until they are known, one or many: made-up drives for the rules, a few real ones for the seams."""

import math
from functools import partial

import numpy as np
import pytest

from bumpymap.lab.evaluate.survey_trial import PatchJob, drive_job
from bumpymap.lab.settings import EvaluateSettings
from bumpymap.lab.simulate.drive import Drive, DriveSettings, Effort, PatchDrives, drive_patch
from bumpymap.lab.simulate.jobs import Journal, drive_jobs
from bumpymap.rating.vehicle_profile import load_profile

WARTHOG = load_profile("warthog")
LEVEL = np.zeros((15, 15))
SHORT = DriveSettings(settle_s=0.5, ramp_s=0.5, cruise_s=0.0, measure_s=1.0)


def drive_patches(patches, drive=None, **how):
    """Drive twice over each patch of a survey, as an evaluation does."""
    settings = EvaluateSettings(min_starts=2, max_starts=2, seed=1, drive=drive or DriveSettings())
    jobs = [PatchJob(key, 2, heights) for key, heights in patches.items()]
    return drive_jobs(partial(drive_job, WARTHOG, 3.0, settings), jobs, **how)


@pytest.fixture
def fake_drive(monkeypatch):
    """Drives whose C_r is drawn from their seed; returns settings of the draw and the seeds that were driven."""
    state = {"spread": 0.2, "fails": 0.0, "seeds": []}

    def drive(_profile, _ground, seed, _settings):
        state["seeds"].append(seed)
        rng = np.random.default_rng(seed)
        failed = rng.random() < state["fails"]
        c_r = math.nan if failed else 0.1 * (1 + state["spread"] * rng.standard_normal())
        return Drive("rolled" if failed else "completed", c_r, 10.0, 10.0)

    monkeypatch.setattr("bumpymap.lab.simulate.drive.drive", drive)
    return state


def test_drives_go_on_until_the_mean_is_known(fake_drive):
    fake_drive["spread"] = 0.35
    effort = Effort(least=4, most=200, target_error=0.05)
    drives = drive_patch(WARTHOG, LEVEL, 3.0, 3, effort)
    assert drives.standard_error <= 0.05 * drives.mean_c_r
    one_less = PatchDrives(drives.outcome[:-1], drives.c_r[:-1])
    assert len(drives.c_r) == 4 or one_less.standard_error > 0.05 * one_less.mean_c_r


def test_patch_that_nothing_crosses_is_given_up_after_the_least(fake_drive):
    fake_drive["fails"] = 1.0
    assert drive_patch(WARTHOG, LEVEL, 3.0, 1, Effort(5, 60, 0.05)).failed == 5


def test_driven_patches_are_taken_from_the_journal(fake_drive, tmp_path):
    patches = {(col, -1): LEVEL for col in range(4)}
    journal = Journal(tmp_path / "j", {"survey": "x"}, PatchDrives.read)
    first = drive_patches(dict(list(patches.items())[:3]), journal=journal)
    fake_drive["seeds"].clear()
    seen = []
    again = drive_patches(patches, journal=journal, progress=lambda *numbers: seen.append(numbers))
    assert {key: again[key] for key in first} == first
    assert len(fake_drive["seeds"]) == 2
    assert seen == [(6, 8), (8, 8)]


@pytest.mark.later
def test_real_drives_are_the_same_in_a_pool():
    pytest.importorskip("dartpy")
    rough = np.random.default_rng(2).normal(0, 0.02, (15, 15))
    patches = {(0, 0): rough, (0, 1): rough.T.copy()}
    alone, pooled = (drive_patches(patches, SHORT, workers=workers) for workers in (1, 2))
    assert alone == pooled
    assert alone[0, 0].completed
