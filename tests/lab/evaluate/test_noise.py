"""The noise proof on few terrains."""

import numpy as np
import pytest

from bumpymap.core.config import FeatureSettings
from bumpymap.core.errors import UsageError
from bumpymap.core.progress import SilentProgress
from bumpymap.lab.evaluate import noise
from bumpymap.lab.evaluate.library import flat_terrains, library_terrains, require_unseen

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def rows(subject, module_patch):
    terrains = library_terrains(subject.calibration, subject.profile, 6, 2)
    return noise.noise_sweep(terrains, subject, subject.ride, None, FeatureSettings(), 6, SilentProgress())


@pytest.fixture(scope="module")
def module_patch():
    patch = pytest.MonkeyPatch()
    patch.setattr(noise, "DENSITIES", (100.0,))
    patch.setattr(noise, "NOISE_M", (0.0, 0.03))
    patch.setattr(noise, "FLAT_TILES", 10)
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
    rows = noise.noise_sweep(terrains, subject, subject.ride, far, FeatureSettings(), 6, SilentProgress())
    assert [row.held for row in rows] == [0.0, 0.0]


def test_perfect_ground_is_rated_as_a_dense_survey_of_it(subject, rows):
    assert rows[0].error[2] < 0.1
    flat = noise.perfect_c_r(flat_terrains(subject.calibration, 2), subject.ride)
    assert flat.max() < 1e-3


def test_ground_of_the_calibration_is_not_unseen(subject):
    own = subject.calibration.settings["seed"]
    with pytest.raises(UsageError, match=f"--seed {own} is that of the calibration"):
        require_unseen(subject.calibration, own)
    require_unseen(subject.calibration, own + 1)
