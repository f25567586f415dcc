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
        (["site.laz", "--set", "model=m.onnx"], "--set model applies to scans: add --scans"),
        (["--scans", "--set", "total_patches=200"], "--set total_patches applies to surveys and vehicles"),
        (["--scans", "--local"], "--local applies to surveys and vehicles"),
        (["--scans", "drive", "--vehicle", "car"], "--vehicle applies to surveys and vehicles"),
        (["--scans", "drive", "--set", "seed=5"], "--set seed applies to surveys and vehicles"),
        ([], "takes surveys"),
        (["--scans"], "with --scans frames"),
    ],
)
def test_options_of_another_evaluation_are_refused(tmp_path, words, message):
    result = evaluate(tmp_path, *words)
    assert result.exit_code == 2, result.output
    assert message in result.stderr
