"""``bumpymap evaluate``: options of one evaluation are refused by the others, before any work."""

import sys

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
        (["site.laz", "--set", "stripes=s.json"], "--set stripes applies to scans: add --scans"),
        (["site.laz", "--set", "scenes=35"], "--set scenes applies to scans: add --scans"),
        (["--scans", "--set", "total_patches=200"], "--set total_patches applies to surveys and vehicles"),
        (["--scans", "--local"], "--local applies to surveys and vehicles"),
        (["--scans", "drive", "--vehicle", "car"], "--vehicle applies to surveys and vehicles"),
        (["--scans", "drive", "--set", "scenes=5"], "--set scenes applies to simulated scenes"),
        ([], "takes surveys"),
    ],
)
def test_options_of_another_evaluation_are_refused(tmp_path, words, message):
    result = evaluate(tmp_path, *words)
    assert result.exit_code == 2, result.output
    assert message in result.stderr


def test_a_simulator_that_cannot_be_loaded_is_no_crash(tmp_path, monkeypatch):
    (tmp_path / "open3d.py").write_text('raise ImportError("libusb-1.0.so.0: cannot open shared object file")')
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    result = evaluate(tmp_path, "--scans")
    assert result.exit_code == 2
    assert (
        "evaluate --scans without frames needs open3d, which is installed but cannot be loaded: libusb-1.0.so.0"
        in result.stderr
    )
    assert "sudo apt-get install libusb-1.0-0 libegl1 libgl1 libx11-6" in result.stderr
