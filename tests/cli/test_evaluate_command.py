"""``bumpymap evaluate``: options of one evaluation are refused by the others, before any work."""

import pytest
from click.testing import CliRunner

from bumpymap.cli import main


def evaluate(tmp_path, *words):
    result = CliRunner().invoke(main, ["evaluate", *words, "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()
    return result


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["survey", "site.laz", "--set", "model=m.onnx"], "model"),
        (["scans", "drive", "--set", "total_patches=200"], "total_patches"),
        (["scans", "drive", "--vehicle", "car"], "--vehicle"),
        (["survey", "site.laz", "--local"], "--local is no option: write --set local=true"),
        (["site.laz"], "bumpymap evaluate survey or bumpymap evaluate scans"),
        (["--scans", "drive"], "bumpymap evaluate scans"),
        (["survey"], "SURVEY"),
        (["scans"], "FRAME"),
    ],
)
def test_options_of_another_evaluation_are_refused(tmp_path, words, message):
    result = evaluate(tmp_path, *words)
    assert result.exit_code == 2, result.output
    assert message in result.stderr
