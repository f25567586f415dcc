"""What a run says at its end, and `max_unknown`."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import bumpymap
from bumpymap.cli import main
from bumpymap.core import MapConfig, TooUnknownError, UsageError
from bumpymap.layers import MapSummary
from bumpymap.survey import FlightLines, MapResult, ground_line

QUARRY = Path(__file__).resolve().parents[2] / "sample_data" / "quarry.laz"
NOTHING = (float("nan"),) * 5


def result(*, ground_only=False, **objects):
    summary = MapSummary(100, 20_000, (100, 0, 0, 0), (0,) * 6, 0, NOTHING, NOTHING, 200.0, **objects)
    return MapResult((), summary, 20_000, ground_only, {}, {}, FlightLines(), rates_thin=True)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (result(judged=100, layered=83, tall=90), "`ground='csf'` looks for the ground beneath"),
        (result(judged=100, layered=3, tall=79), "`ground='csf'` looks for the ground beneath"),
        (result(judged=100, layered=5, tall=21), "`ground='all'` (as here) keeps them"),
        (result(judged=100, layered=6, tall=5), ""),
        (result(), ""),
        (result(judged=100, layered=83, tall=90, ground_only=True), ""),
    ],
)
def test_which_ground_a_survey_wants(found, words):
    said = ground_line(found)
    assert words in said
    assert bool(said) == bool(words)


def test_more_unknown_tiles_than_allowed_are_exit_code_4_and_keep_the_layers(tmp_path):
    out = tmp_path / "out"
    words = ["map", str(QUARRY), "--out", str(out), "--quiet", "--set"]
    failed = CliRunner().invoke(main, [*words, "max_unknown=0.1%"])
    assert failed.exit_code == 4
    assert "tiles are unknown (1.0%), more than the 0.1% that --set max_unknown allows" in failed.output
    assert "mostly because of too many holes" in failed.output
    assert json.loads((out / "run.json").read_text())["counts"]["unknown"] > 0
    again = CliRunner().invoke(main, [*words, "max_unknown=50%"])  # the same run, already done
    assert again.exit_code == 0, again.output
    with pytest.raises(TooUnknownError):
        bumpymap.map_survey(QUARRY, out, max_unknown=0.001)


@pytest.mark.parametrize("share", ["101%", "-1", "nan"])
def test_what_is_no_share_is_refused(share, tmp_path):
    refused = CliRunner().invoke(main, ["map", "a.laz", "--out", str(tmp_path), "--set", f"max_unknown={share}"])
    assert refused.exit_code == 2
    with pytest.raises(UsageError, match="max_unknown"):
        MapConfig((), tmp_path, max_unknown=1.5)
