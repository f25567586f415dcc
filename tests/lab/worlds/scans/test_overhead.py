"""Ground seen all over: no shadows, heights that the ground has, blocks on one side of a line."""

from dataclasses import replace

import numpy as np
import pytest

from bumpymap.lab.worlds.scans.ground import Blob
from bumpymap.lab.worlds.scans.lidar import overhead_scan
from bumpymap.lab.worlds.scans.scene import Scene, make_scene
from bumpymap.lab.worlds.scans.things import Label


@pytest.fixture(scope="module")
def level():
    made = make_scene(1, 0).ground
    made = replace(made, regions=(), hills_m=0.0, bumps_m=0.0, slope=(0.0, 0.0), banks=())
    made = replace(made, cover_rough_m=0.0, cover=Label.DIRT)
    return Scene("level", made, (), (7,))


@pytest.mark.parametrize("seed", range(2))
def test_blocks_lie_on_one_side_and_level_ground_on_the_other(level, seed):
    seen = overhead_scan(level, seed)
    heap = seen.label == Label.RUBBLE
    assert set(np.unique(seen.label)) == {Label.RUBBLE, Label.DIRT}
    assert 0.2 < heap.mean() < 0.8
    floor = np.median(seen.points[~heap, 2])
    assert seen.points[~heap, 2].std() < 0.035  # noise alone
    above = seen.points[heap, 2] - floor
    assert above.min() > -0.15
    assert 0.2 < np.percentile(above, 99) < 0.95
    assert above.std() > 0.06
    away = np.hypot(*seen.points[:, :2].T)
    assert away.min() >= 3.999
    assert away.max() < 60.001


def test_water_has_no_label(level):
    pond = Blob(Label.WATER, (0.0, 0.0), 200.0, (), 0.0, 0.0)
    seen = overhead_scan(replace(level, ground=replace(level.ground, regions=(pond,))), 1)
    assert set(np.unique(seen.label)) == {Label.VOID, Label.RUBBLE}
