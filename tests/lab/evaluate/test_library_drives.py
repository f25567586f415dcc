"""The driver for terrain of the library: drives by kind, and the noise proof on few terrains."""

import library_drives
import numpy as np
import pytest
from _tile_trials import flat_terrains, library_terrains, require_unseen

from bumpymap.core.config import FeatureSettings
from bumpymap.core.errors import UsageError
from bumpymap.core.interrupts import SilentProgress
from bumpymap.lab.evaluate.agreement import DriveStats
from bumpymap.lab.evaluate.survey_trial import TrialOptions

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def rows(subject, module_patch):
    terrains = library_terrains(subject.calibration, subject.profile, 6, 2)
    return library_drives.noise_sweep(terrains, subject, subject.ride, None, FeatureSettings(), 6, SilentProgress())


@pytest.fixture(scope="module")
def module_patch():
    patch = pytest.MonkeyPatch()
    patch.setattr(library_drives, "DENSITIES", (100.0,))
    patch.setattr(library_drives, "NOISE_M", (0.0, 0.03))
    patch.setattr(library_drives, "FLAT_TILES", 10)
    yield
    patch.undo()


@pytest.mark.slow
def test_flat_ground_without_noise_is_flat(rows):
    assert rows[0].flat < 1e-3
    assert rows[0].flat_raw < 1e-3
    assert dict(zip(("density", "noise_m"), (rows[0].density, rows[0].noise_m), strict=True)) == {
        "density": 100,
        "noise_m": 0,
    }


def test_noise_that_is_left_in_reads_as_roughness(rows):
    noisy = rows[1]
    assert noisy.flat_raw > 0.05
    assert noisy.flat < noisy.flat_raw / 2
    assert noisy.flat <= noisy.flat_worst < noisy.flat_raw
    assert noisy.error_raw[0] > noisy.error_raw[2]
    assert noisy.error[0] < noisy.error_raw[0]


def test_driven_c_r_takes_the_place_of_the_truth_in_intervals(subject, module_patch):
    terrains = library_terrains(subject.calibration, subject.profile, 6, 1)
    far = np.full(len(terrains), 50.0)
    far[0] = np.nan
    rows = library_drives.noise_sweep(terrains, subject, subject.ride, far, FeatureSettings(), 6, SilentProgress())
    assert [row.held for row in rows] == [0.0, 0.0]


def test_perfect_ground_is_rated_as_a_dense_survey_of_it(subject, rows):
    assert rows[0].error[2] < 0.1
    flat = library_drives.perfect_c_r(flat_terrains(subject.calibration, 2), subject.ride)
    assert flat.max() < 1e-3


def test_ground_of_the_calibration_is_not_unseen(subject):
    own = subject.calibration.settings["seed"]
    with pytest.raises(UsageError, match=f"--seed {own} is that of the calibration"):
        require_unseen(subject.calibration, own)
    require_unseen(subject.calibration, own + 1)


def test_the_library_is_driven_and_told_apart_by_kind(subject, settings, tmp_path, fake_drives):
    options = TrialOptions(tmp_path, 1, overwrite=False, progress=SilentProgress())
    found = library_drives.evaluate_library(subject, settings, options, noise=False)
    assert len(fake_drives) == found.driven.facts["terrains"] == 17
    assert {row.kind for row in found.kinds} == set(found.driven.facts["kinds"])
    assert len(found.moves) == 8


def test_kinds_are_told_apart(verdict_of):
    c_r, failed = np.array([0.1, 0.2, 0.1, 0.2]), np.array([0, 0, 0, 16])
    driven = DriveStats(c_r, 0.03 * c_r, 16 - failed, failed)
    rows = library_drives.by_kind(["kerb", "kerb", "ruts", "ruts"], verdict_of([0.1, 0.2, 0.2, 0.2]), driven)
    assert [(row.kind, row.compared, row.failed_share) for row in rows] == [("kerb", 2, 0.0), ("ruts", 1, 0.5)]
    assert [row.median_error for row in rows] == pytest.approx([0.0, 1.0])
