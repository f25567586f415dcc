"""What `info` foretells of the unknown tiles is what `map` finds, and both say it in the same words."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from small_surveys import write_las

from bumpymap.cli import main
from bumpymap.core import THIN_POINTS
from bumpymap.core.config import FeatureSettings
from bumpymap.core.types import Reason
from bumpymap.readers.summary import thin_rule
from bumpymap.survey.advice import Outcome, advise, enough_points
from bumpytiles import Grid

pytestmark = pytest.mark.slow

SETTINGS = FeatureSettings()
CLASS_2 = "ground points"


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
        (1.5, 0.0, "larger tiles: bumpymap info --tile-size 4 says"),
        (5.0, 0.0, ""),
        (14.0, 0.08, "--ground all measures every point, 126 per tile"),
        (1.4, 0.8, "All points (--ground all) are too few as well, 13 per tile"),
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


@pytest.mark.parametrize("name", ["churo_sparse.laz", "csf_double_xyz.ply", "bcts_adjoining/bcts_1.laz"])
@pytest.mark.parametrize("ground", ["auto", "all"])
def test_what_is_foretold_of_real_surveys_is_found(tmp_path, shared_data, name, ground):
    survey = shared_data / "surveys" / name
    foretold, found, *_ = foretold_and_found(tmp_path / "out", survey, "--ground", ground)
    assert foretold == pytest.approx(found, abs=0.05)


def test_larger_tiles_are_advised_only_where_they_help(tmp_path):
    survey = write(tmp_path / "a.laz", 1.2)
    (record,) = run("info", survey, "--json")["files"]
    assert sum(record["unknown_tiles_about"].values()) > 0.5
    size = record["needs"][-1].split("bumpymap info --tile-size ")[1].split()[0]
    (record,) = run("info", survey, "--tile-size", size, "--json")["files"]
    assert sum(record["unknown_tiles_about"].values()) < 0.2


def test_a_rating_without_thin_tiles_states_the_rule_of_heightmaps(tmp_path):
    survey = write(tmp_path / "a.laz", 4.5)
    mapped = run("map", survey, "--local", "--out", tmp_path / "out", "--set", "rating=table", "--json")
    assert "less than 25% of the pixels with one" in mapped["advice"]
    again = run("map", survey, "--local", "--out", tmp_path / "out", "--set", "rating=table", "--json")
    assert again["already_done"]
    assert again["advice"] == mapped["advice"]


def outcome(reason, share, measured="points", held=20.0, every=200.0, tiles=100, thin=False):
    return Outcome(tiles, {reason: share * tiles}, measured, held, every, thin)


def thin_outcome(*given, **more):
    return outcome(*given, **more, thin=True)


@pytest.mark.parametrize(
    ("outcome", "words"),
    [
        (outcome(Reason.TOO_FEW_POINTS, 0.1), ""),
        (outcome(Reason.TOO_FEW_POINTS, 0.9, held=20.0), "bumpymap map --tile-size 6 --calibration my.json"),
        (
            outcome(Reason.TOO_FEW_POINTS, 0.3, CLASS_2, held=386.0),
            "Most tiles hold enough; the others have little ground",
        ),
        (outcome(Reason.NO_GROUND, 0.9, CLASS_2), "--ground csf detects ground points"),
        (outcome(Reason.NO_GROUND, 0.9, CLASS_2, every=10.0), "bumpymap info --tile-size 8 --ground all says"),
        (outcome(Reason.TOO_MANY_HOLES, 0.9, tiles=4), "4 tiles of 3 m, most of them at its edge"),
        (outcome(Reason.TOO_MANY_HOLES, 0.9, held=500.0), "max_hole"),
        (outcome(Reason.TOO_MANY_HOLES, 0.9, held=40.0), "--tile-size 5"),
        (outcome(Reason.OUTLIER_RELIEF, 0.9), "class 7 or 18"),
        (thin_outcome(Reason.TOO_FEW_POINTS, 0.9, held=9.0), "at least 15 are needed, in most parts of the tile"),
        (
            thin_outcome(Reason.TOO_FEW_POINTS, 0.2, held=32.0),
            "at the edge of the survey, and where it is sparse",
        ),
        (thin_outcome(Reason.TOO_FEW_POINTS, 0.9, held=0.1), "a denser one is needed"),
        (thin_outcome(Reason.NO_GROUND, 0.9, CLASS_2, every=10.0), "--ground all) are too few as well"),
        (thin_outcome(Reason.TOO_MANY_HOLES, 0.9, held=60.0), "no point in a square of 2 m, or in most of the tile"),
    ],
)
def test_what_would_help(outcome, words):
    said = advise(outcome, Grid(), SETTINGS, before_run=False)
    assert words in said
    assert ("bumpymap calibrate" in said) == ("bumpymap calibrate --vehicle NAME_OR_FILE --tile-size" in said)
    assert bool(said) == bool(words)
    assert "--ground csf" not in said or outcome.measured == CLASS_2


def test_enough_points_covers_as_many_pixels_as_asked():
    grid = Grid()
    enough = enough_points(grid, SETTINGS, thin=False)
    rng = np.random.default_rng(5)
    covered = [np.unique(rng.integers(0, 225, enough)).size / 225 for _ in range(400)]
    assert np.mean(covered) == pytest.approx(0.25, abs=0.01)
    assert enough_points(grid, FeatureSettings(min_points=500), thin=False) == 500


def test_enough_points_of_a_thin_tile_span_it():
    enough = enough_points(Grid(), SETTINGS, thin=True)
    assert enough == THIN_POINTS
    pixels = np.zeros((4000, 225), np.bool_)
    pixels[np.arange(4000)[:, None], np.random.default_rng(5).integers(0, 225, (4000, enough))] = True
    spanned = thin_rule(pixels.reshape(-1, 15, 15))
    assert 0 < (~spanned).sum() < 12
