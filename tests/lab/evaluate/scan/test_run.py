"""A whole evaluation of scans on a small drive."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from bumpymap.cli import main

pytestmark = pytest.mark.slow


def ground(seed, rough=0.3):
    """A field that is smooth on the right and churned on the left, as (n, 4) rows of a .bin file."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-18, 18, (60_000, 2))
    z = -1.5 + rng.normal(0, 0.01, len(place)) + np.where(place[:, 1] > 0, rough * rng.uniform(-1, 1, len(place)), 0)
    return np.column_stack([place, z, np.zeros(len(place))]).astype("<f4")


@pytest.fixture
def drive(tmp_path):
    folder = tmp_path / "drive"
    folder.mkdir()
    for frame in range(2):
        ground(frame).tofile(folder / f"{frame:06d}.bin")
    return folder


def test_a_report_holds_both_methods(drive, tmp_path):
    out = tmp_path / "out"
    run = CliRunner().invoke(main, ["evaluate", "scans", str(drive), "--out", str(out)], catch_exceptions=False)
    assert run.exit_code == 0, run.output
    record = json.loads((out / "report.json").read_text())
    assert record["facts"]["scans"] == 2
    assert record["facts"]["labelled"] == 0
    assert record["accuracy"] == {}
    sectors = [sum(row["sectors"] for row in record["classes"][method]) for method in ("filter", "learned")]
    assert sectors == [record["facts"]["sectors"]] * 2
    smooth, *_, rough = record["classes"]["filter"]
    assert smooth["variance"][0] < rough["variance"][0]
    assert smooth["stripes"][0] > rough["stripes"][0]
    text = (out / "report.md").read_text()
    assert "Compared with labels" not in text
    assert "## Ground" not in text
    assert "nan" not in text
    again = CliRunner().invoke(main, ["evaluate", "scans", str(drive), "--out", str(out)])
    assert again.exit_code != 0
    assert "--overwrite" in again.output


def label_drive(folder, ids):
    """Label the left side of frames from ``ground`` with one id, the right with another."""
    for frame in folder.glob("*.bin"):
        left = np.fromfile(frame, "<f4").reshape(-1, 4)[:, 1] > 0
        np.where(left, *ids).astype("<u4").tofile(frame.with_suffix(".label"))


def test_labels_set_both_methods_beside_constant_answers(drive, tmp_path):
    label_drive(drive, (14, 9))  # a fence all over the left side, road on the right
    out = tmp_path / "out"
    words = ["evaluate", "scans", str(drive), "--labels", "kitti", "--out", str(out)]
    run = CliRunner().invoke(main, words, catch_exceptions=False)
    assert run.exit_code == 0, run.output
    record = json.loads((out / "report.json").read_text())
    names = ["filter", "learned", "always 0", "always 1", "always 2", "deviation of z"]
    assert list(record["accuracy"]) == list(record["accuracy_all"]) == names
    assert record["facts"]["labels"] == "kitti"
    constant = record["accuracy"]["always 2"]
    assert constant["recall"] == [0.0, None, 1.0]
    assert constant["even"] == 0.5
    assert [row["frame"] for row in record["ground"]] == ["000000", "000001", "mean"]
    assert all(0 < row["precision"] < 1 and row["recall"] > 0.95 for row in record["ground"])
    assert set(record["obstacles"]) == {"filter", "learned"}
    text = (out / "report.md").read_text()
    for name in names:
        assert f"| {name} |" in text
        assert name in run.output
    assert "nan" not in text


@pytest.mark.parametrize(
    ("ids", "words", "code", "message"),
    [
        ((70, 40), ("--labels", "kitti"), 3, "not those of the set kitti"),
        ((500, 501), (), 3, "fit no label set"),
        ((14, 9), ("--labels", "nuscenes"), 2, "it must be kitti"),
        (None, ("--labels", "kitti"), 3, "has no labels"),
    ],
)
def test_labels_of_another_set_are_refused(drive, tmp_path, ids, words, code, message):
    if ids:
        label_drive(drive, ids)
    run = CliRunner().invoke(main, ["evaluate", "scans", str(drive), *words, "--out", str(tmp_path / "out")])
    assert run.exit_code == code, run.output
    assert re.search(message, run.output.replace("\n", " "))
    assert not (tmp_path / "out" / "report.md").exists()


def test_an_empty_drive_says_so(tmp_path):
    np.zeros((50, 4), "<f4").tofile(tmp_path / "0.bin")
    run = CliRunner().invoke(main, ["evaluate", "scans", str(tmp_path), "--out", str(tmp_path / "out")])
    assert run.exit_code == 3
    assert "no scan has a sector" in run.output
