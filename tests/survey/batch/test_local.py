"""A batch in which one survey has no CRS: `local` is given for it, and has no effect on the others."""

import numpy as np
from small_surveys import run, write_las, write_survey


def test_a_setting_for_one_survey_keeps_the_maps_of_the_others(tmp_path):
    (tmp_path / "surveys").mkdir()
    write_survey(tmp_path / "surveys" / "placed.laz", points=4_000)
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(0.0, 12.0, (4_000, 2)), rng.normal(0.0, 0.01, 4_000)])
    write_las(tmp_path / "surveys" / "free.laz", *points.T, crs=None, offset=(0, 0, 0))
    words = ("batch", tmp_path / "surveys", "--out", tmp_path / "maps")
    first = run(*words)
    assert first.exit_code == 4
    assert "free failed" in first.output
    again = run(*words, "--set", "local=true")
    assert again.exit_code == 0, again.output
    assert "1 done" in again.output
    assert "1 already done" in again.output
