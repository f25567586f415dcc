"""Short versions of the checks that ``bumpymap calibrate --check`` makes in full."""

import pytest

from bumpymap.lab.simulate.drive import DriveSettings
from bumpymap.lab.simulate.jobs import check_plane, check_repeat, check_sine, check_step
from bumpymap.lab.simulate.model import Physics
from bumpymap.rating.vehicle_profile import load_profile

pytestmark = pytest.mark.slow

pytest.importorskip("dartpy")
WARTHOG = load_profile("warthog")
SHORT = DriveSettings(measure_s=5.0)


@pytest.mark.parametrize(("degrees", "heading"), [(0, 0), (30, 0), (30, 90)])
def test_planes_shake_nothing(degrees, heading):
    result = check_plane(WARTHOG, degrees, heading, SHORT)
    assert result.ok, result


@pytest.mark.parametrize("wavelength", [2.0, 2.5, 5.0])
def test_sine_meets_its_closed_form(wavelength):
    result = check_sine(WARTHOG, wavelength, SHORT)
    assert result.ok, result


@pytest.mark.later
def test_half_the_time_step_changes_little():
    result = check_step(WARTHOG, patches=6, settings=SHORT)
    assert result.ok, result


@pytest.mark.later
def test_same_seed_gives_the_same_bits_in_another_process():
    result = check_repeat(WARTHOG, 3, SHORT)
    assert result.ok, result


def test_checks_can_fail():
    # On ice the vehicle goes nowhere; a wave at the step that is far too coarse is not followed.
    ice = DriveSettings(measure_s=1.0, physics=Physics(friction=0.0))
    assert not check_plane(WARTHOG, 30, 0, ice).ok
    assert not check_sine(WARTHOG, 2.5, ice).ok
