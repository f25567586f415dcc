"""Models are fitted again from what a calibration holds, without driving."""

import copy
from dataclasses import replace

import pytest

from bumpymap.core import UsageError
from bumpymap.lab.simulate.refit import refit
from bumpymap.rating import Calibration

WARTHOG = Calibration.shipped("warthog")


def test_a_calibration_that_was_moved_to_real_drives_is_refused():
    moved = replace(WARTHOG, settings=WARTHOG.settings | {"moved_to_drives": {"calibration_id": WARTHOG.id}})
    with pytest.raises(UsageError, match=f"moved to real drives.*Fit the calibration {WARTHOG.id}.*check --refit"):
        refit(moved)


def test_a_calibration_without_the_library_is_refused():
    settings = copy.deepcopy(WARTHOG.settings)
    del settings["library"]
    with pytest.raises(UsageError, match="holds no drives over the terrain library"):
        refit(replace(WARTHOG, settings=settings))
