from pathlib import Path

import numpy as np
import pytest

from bumpymap.lab.evaluate import survey_trial
from bumpymap.lab.evaluate.rated_survey import Subject, Verdict
from bumpymap.lab.settings import EvaluateSettings
from bumpymap.lab.simulate.drive import DriveSettings, PatchDrives
from bumpymap.rating import Calibration, TextureModel


@pytest.fixture(scope="session")
def subject():
    return Subject.of(Calibration.shipped("warthog"), TextureModel.shipped())


@pytest.fixture(scope="session")
def settings():
    """Few and short drives."""
    drive = DriveSettings(settle_s=0.5, ramp_s=0.5, cruise_s=0.0, measure_s=1.0)
    return EvaluateSettings(total_patches=10, min_starts=2, max_starts=2, drive=drive)


@pytest.fixture(scope="session")
def quarry():
    """A part of the sample survey, 36 whole tiles."""
    return Path(__file__).resolve().parents[3] / "sample_data" / "quarry_part.ply"


@pytest.fixture
def verdict_of():
    """What a rating may say."""

    def made(c_r, class_id=None, p_fail=None, spread=1.2):
        c_r = np.asarray(c_r, float)
        none = np.zeros(len(c_r))
        class_id = none.astype(np.uint8) if class_id is None else np.asarray(class_id, np.uint8)
        p_fail = none if p_fail is None else np.asarray(p_fail, float)
        return Verdict(class_id, c_r, c_r / spread, c_r * spread, p_fail, none + 0.8)

    return made


@pytest.fixture
def fake_drives(monkeypatch):
    """Drives that cost nothing: C_r is the relief. Returns the keys of those that were made."""
    made = []

    def run(_profile, _tile_size, _settings, job):
        made.append(job.key)
        c_r = 0.01 + float(np.std(job.heights))
        return PatchDrives(("completed",) * 2, (c_r, 1.05 * c_r))

    monkeypatch.setattr(survey_trial, "require_dart", lambda: None)
    monkeypatch.setattr(survey_trial, "drive_job", run)
    return made
