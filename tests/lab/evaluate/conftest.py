import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bumpymap.lab.evaluate import survey_trial
from bumpymap.lab.evaluate.rated_survey import Subject, Verdict
from bumpymap.lab.settings import EvaluateSettings
from bumpymap.lab.simulate.drive import DriveSettings, PatchDrives
from bumpymap.rating import DrivenPatches, NoisyPatches, fit_correction
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.ride.motion_operator import Rides
from bumpymap.rating.textures import TextureModel
from bumpymap.rating.vehicle_profile import load_profile

QUARRY = Path(__file__).resolve().parents[3] / "sample_data" / "quarry.laz"


@pytest.fixture(scope="session")
def ride_record():
    """A ride model as a calibration holds it, fitted to made-up drives: C_r is 1.25 times what geometry says."""
    rng = np.random.default_rng(1)
    g = np.exp(rng.uniform(np.log(0.003), np.log(1.5), 200))
    rides = Rides(g, g * 1.3, g / 3, g / 3, g / 4 * rng.uniform(0.5, 2, 200), g, g / 2, g / 9)
    failed = rng.binomial(8, 1 / (1 + np.exp(-6 * (np.log(g) + 0.2))))
    c_r = 1.25 * g * np.exp(0.08 * rng.standard_normal(200))
    driven = DrivenPatches(rides, rng.uniform(0, 20, 200), c_r, 0.05 * c_r, 8 - failed, failed)
    excess = rng.exponential(0.5, 300)
    noisy = NoisyPatches(excess, np.exp(rng.uniform(-0.5, 4, 300)), 0.2 * excess * rng.standard_normal(300))
    return json.loads(json.dumps(fit_correction(driven, noisy).to_record()))


@pytest.fixture(scope="session")
def subject(ride_record):
    """The shipped table with that ride model."""
    vehicle = load_profile("warthog").to_dict()
    calibration = replace(Calibration.shipped("warthog"), vehicle=vehicle, ride=ride_record)
    return Subject.of(calibration, TextureModel.shipped())


@pytest.fixture(scope="session")
def settings():
    """Few and short drives."""
    drive = DriveSettings(settle_s=0.5, ramp_s=0.5, cruise_s=0.0, measure_s=1.0)
    return EvaluateSettings(total_patches=10, min_starts=2, max_starts=2, drive=drive)


@pytest.fixture(scope="session")
def quarry(tmp_path_factory):
    """A file of some hundred tiles of the sample survey."""
    import laspy

    whole = laspy.read(QUARRY)
    west, south, _ = whole.header.mins
    near = (whole.x < west + 60) & (whole.y < south + 60)
    path = tmp_path_factory.mktemp("survey") / "corner.laz"
    crop = laspy.LasData(whole.header)
    crop.points = whole.points[np.asarray(near)]
    crop.write(path)
    return path


def verdict_of(c_r, class_id=None, p_fail=None, spread=1.2):
    """What a rating may say."""
    c_r = np.asarray(c_r, float)
    n = len(c_r)
    return Verdict(
        np.zeros(n, np.uint8) if class_id is None else np.asarray(class_id, np.uint8),
        c_r,
        c_r / spread,
        c_r * spread,
        np.zeros(n) if p_fail is None else np.asarray(p_fail, float),
        np.full(n, 0.8),
    )


@pytest.fixture(name="verdict_of")
def verdict_of_fixture():
    return verdict_of


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
