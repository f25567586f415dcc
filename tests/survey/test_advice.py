"""What `info` foretells of the unknown tiles is what `map` finds, and both say it in the same words."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from small_surveys import write_las

from bumpymap.cli import main
from bumpymap.core.config import FeatureSettings
from bumpymap.core.types import Reason
from bumpymap.survey.advice import Outcome, advise

pytestmark = pytest.mark.slow


def write(path, density, ground_share=0.0, side=60.0):
    """Write points at random over a square of 20 x 20 tiles."""
    rng = np.random.default_rng(3)
    count = int(density * side**2)
    x, y = 500001 + rng.uniform(0.001, side - 0.001, count), 4000002 + rng.uniform(0.001, side - 0.001, count)
    z, kind = rng.normal(0.0, 0.02, count), np.where(rng.random(count) < ground_share, 2, 1).astype(np.uint8)
    return write_las(path, x, y, z, crs=None, classification=kind)


def run(*words):
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout.strip().splitlines()[-1] if words[0] == "map" else result.stdout)


def foretold_and_found(out, *words):
    """Shares of the tiles that are unknown, and the sentences, of `info` and of `map`."""
    (record,) = run("info", *words, "--json")["files"]
    mapped = run("map", *words, "--local", "--out", out, "--json")
    found = sum(mapped["unknown"].values()) / mapped["tiles"]
    return sum(record["unknown_tiles_about"].values()), found, record["needs"][-1], mapped["advice"]


@pytest.mark.parametrize(
    ("density", "ground_share", "words"),
    [
        (0.4, 0.0, "larger tiles: bumpymap info --tile-size 5 (or 6) says how many are unknown then"),
        (5.0, 0.0, ""),
        (14.0, 0.02, "--ground all measures every point, 126 per tile"),
        (0.4, 0.8, "A denser survey would help"),
        (60.0, 0.5, ""),
    ],
)
def test_what_is_foretold_is_found(tmp_path, density, ground_share, words):
    survey = write(tmp_path / "a.laz", density, ground_share)
    foretold, found, before, after = foretold_and_found(tmp_path / "out", survey)
    assert foretold == pytest.approx(found, abs=0.02)
    assert words in before
    assert words in after
    if found > 0.1:
        assert after.startswith(f"{found:.1%} of the tiles are unknown")
        assert before == after.replace(f"{found:.1%} of the tiles are", f"about {found:.0%} of the tiles will be")
    else:
        assert after in {
            "no tile with points is unknown",
            f"{found:.1%} of the tiles are unknown, mostly because of too few points",
        }
        assert "no CRS" in before


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["churo_sparse.laz", "csf_double_xyz.ply", "bcts_adjoining/bcts_1.laz"])
@pytest.mark.parametrize("ground", ["auto", "all"])
def test_what_is_foretold_of_real_surveys_is_found(tmp_path, shared_data, name, ground):
    survey = shared_data / "surveys" / name
    foretold, found, *_ = foretold_and_found(tmp_path / "out", survey, "--ground", ground)
    assert foretold == pytest.approx(found, abs=0.05)


def test_a_rating_without_thin_tiles_states_the_rule_of_heightmaps(tmp_path):
    survey = write(tmp_path / "a.laz", 4.5)
    mapped = run("map", survey, "--local", "--out", tmp_path / "out", "--set", "rating=table", "--json")
    assert "less than 25% of the pixels with one" in mapped["advice"]
    again = run("map", survey, "--local", "--out", tmp_path / "out", "--set", "rating=table", "--json")
    assert again["already_done"]
    assert again["advice"] == mapped["advice"]


@pytest.mark.parametrize(
    ("reason", "measured", "every", "thin", "words"),
    [
        (Reason.TOO_FEW_POINTS, "points", 20.0, False, "20 points per tile (median); at least 30 are needed"),
        (Reason.TOO_FEW_POINTS, "points", 20.0, True, "at least 4 are needed"),
        (Reason.NO_GROUND, "ground points", 200.0, False, "--ground csf detects ground points"),
        (Reason.NO_GROUND, "ground points (found by the cloth)", 200.0, True, "vegetation too"),
        (Reason.TOO_MANY_HOLES, "points", 60.0, True, "no point in most parts of the tile"),
        (Reason.OUTLIER_RELIEF, "points", 200.0, False, "class 7 or 18"),
    ],
)
def test_what_would_help(reason, measured, every, thin, words):
    said = advise(Outcome(100, {reason: 90}, measured, 20.0, every, thin), FeatureSettings(), before_run=False)
    assert words in said
    assert ("--ground csf" in said) == (measured == "ground points")
