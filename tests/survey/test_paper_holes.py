"""The paper's rules on a sparse survey: the summary says which share of class 3 only its rule of holes made."""

import json

import numpy as np
import pyarrow.parquet as pq
from click.testing import CliRunner
from small_surveys import write_las

from bumpymap.cli import main


def mapped(survey, out, *words):
    done = CliRunner().invoke(main, ["map", str(survey), "--out", str(out), "--local", *words])
    assert done.exit_code == 0, done.output
    counts = json.loads((out / "run.json").read_text(encoding="utf-8"))["counts"]
    return done.stdout, counts, pq.read_table(out / "tiles.parquet")


def test_the_share_that_only_the_rule_of_holes_made_is_said_once(tmp_path):
    rng = np.random.default_rng(3)
    count = np.where(np.arange(100) % 4 == 0, 600, 40)  # tiles in which all pixels hold a point, or a sixth
    first = np.array([500_001.0, 4_000_002.0]) + 3.0 * np.stack(np.divmod(np.arange(100), 10), axis=1)
    corner = np.repeat(first, count, axis=0)
    points = np.column_stack([corner + rng.uniform(0.0, 3.0, corner.shape), rng.normal(0.0, 0.01, len(corner))])
    survey = write_las(tmp_path / "a.las", *points.T, crs=None)
    said, counts, table = mapped(survey, tmp_path / "paper", "--set", "compat=paper")
    judged = np.array(table["coverage"]) >= 0.7
    assert counts["by_holes"] == (~judged).sum() == 75
    assert "  only by the paper's rule of holes" in said
    assert said.count("compat='paper': 75.0% of the tiles are class 3") == 1
    assert (np.array(table["class"])[~judged] == 3).all()
    said, counts, _ = mapped(survey, tmp_path / "ride")
    assert "by_holes" not in counts
    assert "compat" not in said
