"""Maps with a moved calibration have the C_r that was promised."""

import math

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest

from bumpymap.api import map_survey
from bumpymap.rating import Calibration
from bumpymap.rating.drive_update import LogMove, moved_calibration

ROUGH = ("c_r", "c_r_low", "c_r_high", "p_fail", "coverage")


@pytest.fixture(scope="module")
def survey(tmp_path_factory, request):
    """A part of the sample survey of 60 m by 60 m."""
    whole = laspy.read(request.config.rootpath / "sample_data" / "quarry.laz")
    east, north = whole.x - whole.x.min(), whole.y - whole.y.min()
    part = laspy.LasData(whole.header, whole.points[(east > 30) & (east < 90) & (north > 20) & (north < 80)])
    path = tmp_path_factory.mktemp("survey") / "part.laz"
    part.write(path)
    return path


def mapped(survey, folder, **options):
    map_survey(survey, folder, **options)
    table = pq.read_table(folder / "tiles.parquet", columns=["col", "row", *ROUGH]).to_pydict()
    return {name: np.array([np.nan if v is None else v for v in values], float) for name, values in table.items()}


def test_a_map_with_a_moved_calibration_moves_as_promised(tmp_path, survey):
    old = Calibration.shipped("warthog")
    move = LogMove(math.log(old.class_limits[1]), 0.25, 0.1, np.diag([1e-6, 1e-6]), 1.0)
    file = tmp_path / "moved.json"
    file.write_text(moved_calibration(old, move, {}).to_json(), encoding="utf-8")
    before = mapped(survey, tmp_path / "before", vehicle="warthog")
    after = mapped(survey, tmp_path / "after", calibration=file)
    known = np.isfinite(before["c_r"])
    assert np.array_equal(known, np.isfinite(after["c_r"]))
    off = np.log(after["c_r"][known]) - move.log(np.log(before["c_r"][known]))
    # Beyond the calibrated range C_r stays proportional to the ground, and thin tiles lean on neighbours.
    assert np.quantile(np.abs(off), 0.9) < 0.02
    assert np.median(np.abs(off)) < 1e-3
    assert np.median(after["c_r"][known] / before["c_r"][known]) > 1.02
    assert np.mean(np.abs(after["p_fail"][known] - before["p_fail"][known]) < 1e-3) > 0.95
