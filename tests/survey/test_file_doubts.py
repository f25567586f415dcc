"""Files that cannot be of one survey, or not where they say, are named by `info` and by `map`."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from small_surveys import write_las

from bumpymap.cli import main

HERE = (480_717.0, 2_135_914.0)


def cloud(path, place=HERE, *, height=100.0, factor=1.0, more=(), count=2_000):
    """Level ground of 30 m x 30 m with a noise of 2 cm; ``more``: points at other places."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(0.0, 30.0, (count, 2)) + place, rng.normal(height, 0.02, count) * factor])
    x, y, z = np.concatenate([points, np.array(more).reshape(-1, 3)]).T
    return write_las(path, x, y, z, crs=None, offset=(x.min(), y.min(), 0.0), scales=(0.01,) * 3)


def told(files, tmp_path):
    """Return what info and map say of files in UTM zone 14, and the exit code of map."""
    words = [*map(str, files), "--crs", "EPSG:32614"]
    facts = json.loads(CliRunner().invoke(main, ["info", *words, "--quick", "--json"]).stdout)
    run = CliRunner().invoke(main, ["map", *words, "--out", str(tmp_path / "out")])
    return facts["doubts"], run


@pytest.mark.parametrize(
    ("second", "says", "code"),
    [
        ({"place": (HERE[0] + 30.0, HERE[1]), "height": 130.0}, "of another datum", 0),
        ({"place": (HERE[0] + 30.0, HERE[1]), "factor": 1 / 0.3048}, "in feet", 0),
        ({"place": (0.0, 0.0)}, "at the origin (0, 0): leave it out?", 3),
        ({"place": (HERE[0] + 400_000.0, HERE[1])}, "lies 400 km from all other files: leave it out?", 3),
        ({"more": [(0.0, 0.0, 0.0)] * 9}, "some lie at the origin (0, 0)", 3),
        ({"more": [(HERE[0], 5e6, 100.0)]}, "there may be stray coordinates", 3),
    ],
    ids=["datum", "feet", "origin", "far", "points at the origin", "stray"],
)
def test_a_file_that_does_not_fit_is_named_with_the_evidence(tmp_path, second, says, code):
    files = cloud(tmp_path / "a.las"), cloud(tmp_path / "b.las", **second)
    doubts, run = told(files, tmp_path)
    assert any(says in doubt and "b.las" in doubt for doubt in doubts), doubts
    assert run.exit_code == code, run.output
    assert says in run.stderr


def test_files_that_fit_are_not_doubted(tmp_path):
    beside = cloud(tmp_path / "b.las", (HERE[0] + 30.0, HERE[1]), height=104.0)
    below = cloud(tmp_path / "c.las", (HERE[0] + 90.0, HERE[1]), height=180.0)  # not beside them
    doubts, run = told([cloud(tmp_path / "a.las"), beside, below], tmp_path)
    assert doubts == []
    assert run.exit_code == 0
    assert "heights" not in run.stderr
