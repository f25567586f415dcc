import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from bumpymap.core.errors import BumpymapError
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate import calibrate
from bumpymap.lab.simulate.calibrate import class_limits, natural_breaks
from bumpymap.lab.simulate.drive import PatchDrives
from bumpymap.lab.worlds.terrains import KINDS
from bumpymap.rating.calibration import DrivenTerrain
from bumpymap.rating.vehicle_profile import load_profile

SETTINGS = CalibrationSettings(load_profile("warthog"), patches=3, starts=2, z_range=(0.1, 1.0), terrains=4)


def drives(*c_r):
    return PatchDrives(tuple("completed" if c is not None else "rolled" for c in c_r), c_r)


def terrain(c_r, completed=8, failed=0):
    return DrivenTerrain("kerb", 0, c_r, 0.01, completed, failed, 0)


@given(st.lists(st.floats(0.001, 2.0), min_size=5, max_size=10, unique_by=lambda v: round(v, 4)))
def test_natural_breaks_are_the_best_of_all_splits(values):
    def spread(groups):
        return sum(((g - g.mean()) ** 2).sum() for g in groups)

    x = np.sort(values)
    limits = natural_breaks(np.array(values), 4)
    found = spread(np.split(x, np.searchsorted(x, limits)))
    best = min(spread(np.split(x, cuts)) for cuts in combinations(range(1, len(x)), 3))
    assert found == pytest.approx(best, rel=1e-9, abs=1e-12)


def test_failed_drives_count_in_p_fail_and_not_in_c_r():
    # C_r grows by texture and z range; patches differ. In the last cell, three of six drives failed.
    cells = {(t, z): [drives(0.02 * 2**t * (1 + 4 * z) * f) for f in (0.8, 1, 1.2)] for t in range(4) for z in (0, 1)}
    cells[3, 1] = [drives(0.5, None), drives(None, None), drives(1.5, 2.5)]
    results = {("table", *place, patch): d for place, cell in cells.items() for patch, d in enumerate(cell)}
    library = [("library", kind, index) for kind in KINDS for index in range(4)]
    results |= {name: drives(0.01 * (1 + i)) for i, name in enumerate(library)}
    calibration = calibrate.summarise(SETTINGS, results)
    assert calibration.p_fail[3][1] == pytest.approx(3 / 6)
    assert calibration.c_r[3][1] == pytest.approx((0.5 + 2.0) / 2)
    assert calibration.c_r_log_sd[3][1] == pytest.approx(math.log(4) / math.sqrt(2))


def test_terrains_that_cannot_be_crossed_do_not_move_the_limits():
    crossed = [terrain(c) for c in (0.1, 0.11, 0.3, 0.31, 0.6, 0.61, 1.0, 1.01)]
    lost = [terrain(5.0, 5, 3), terrain(None, 0, 8)]
    kept = [terrain(1.08, 6, 2)]
    assert class_limits(crossed + lost) == class_limits(crossed) == pytest.approx((0.205, 0.455, 0.805))
    assert class_limits(crossed + kept) == pytest.approx((0.205, 0.455, 0.8175), abs=0.0006)


def test_vehicle_that_fails_everywhere_and_limits_too_close_together_are_refused():
    with pytest.raises(BumpymapError, match="crosses 3 of 9 terrains"):
        class_limits([terrain(0.1 * i) for i in (1, 2, 3)] + [terrain(0.1, 1, 7)] * 6)
    with pytest.raises(BumpymapError, match="too close together"):
        class_limits([terrain(1e-5 * i) for i in range(1, 20)])
