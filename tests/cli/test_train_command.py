"""``bumpymap train`` as a user meets it: two networks, one command, no mixture of their options."""

import re

import numpy as np
import pytest
from click.testing import CliRunner

from bumpymap.cli import main, train_command

pytestmark = pytest.mark.slow

POINTS, LABELS = "os1_cloud_node_kitti_bin", "os1_cloud_node_semantickitti_label_id"
SHORT = ("--set", "epochs=2", "--set", "sectors_per_class=32")


def train(*words):
    return CliRunner().invoke(main, ["train", *map(str, words)])


def ground(seed, count=9_000):
    """Asphalt, grass and bushes, a third of a circle each; returns points and their labels."""
    rng = np.random.default_rng(seed)
    radius, azimuth = np.sqrt(rng.uniform(16.0, 400.0, count)), rng.uniform(0, 2 * np.pi, count)
    third = (azimuth // (2 * np.pi / 3)).astype(int)
    z = -1.0 + np.array([0.003, 0.06, 0.4])[third] * rng.standard_normal(count)
    points = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z, np.ones(count)])
    return points.astype("<f4"), np.array([10, 3, 19], "<u4")[third]


@pytest.fixture(name="folder", scope="module")
def folder_fixture(tmp_path_factory):
    """Three frames in the layout of RELLIS-3D."""
    root = tmp_path_factory.mktemp("data") / "Rellis-3D"
    for number in range(3):
        points, labels = ground(number)
        for name, suffix, values in ((POINTS, "bin", points), (LABELS, "label", labels)):
            (root / "00000" / name).mkdir(parents=True, exist_ok=True)
            values.tofile(root / "00000" / name / f"{number:06d}.{suffix}")
    return root


def require_torch():
    pytest.importorskip("torch", reason="torch comes with the extra 'learn'")
    pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")


def test_a_network_from_a_folder_classes_scans(folder, tmp_path):
    require_torch()
    out = tmp_path / "own.onnx"
    result = train("scans", folder, "--out", out, "--set", "seed=5", *SHORT)
    assert result.exit_code == 0, result.output
    assert [line.split(":")[0] for line in result.stderr.splitlines()] == ["epoch 1/2", "epoch 2/2"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["own.md", "own.onnx"]
    card = (tmp_path / "own.md").read_text(encoding="utf-8")
    said = re.findall(r"([\d.]+) %", result.stdout)
    assert len(said) == 2
    assert all(f"{share} %" in card for share in said)
    frame = folder / "00000" / POINTS / "000002.bin"
    used = CliRunner().invoke(main, ["scan", str(frame), "--out", str(tmp_path / "o"), "--set", f"model={out}"])
    assert used.exit_code == 0, used.output
    assert f"bumpymap scan FRAME --out DIR --set model={out}" in result.stdout
    before = out.read_bytes()
    out.write_text("an older one")
    assert train("scans", folder, "--out", out, "--set", "seed=5", *SHORT, "--overwrite").exit_code == 0
    assert out.read_bytes() == before


@pytest.mark.parametrize("kind", [["textures"], ["scans", "folder"]])
def test_a_network_that_is_there_is_kept(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(train_command, "find_spec", lambda _: object())
    out = tmp_path / "m.onnx"
    out.write_text("mine")
    result = train(*kind, "--out", out)
    assert result.exit_code == 3
    assert "--overwrite" in result.stderr
    assert out.read_text() == "mine"


def test_ctrl_c_says_how_to_go_on(folder, tmp_path):
    require_torch()
    from bumpymap.lab.train import scan_net

    with pytest.MonkeyPatch.context() as patch:
        draw, moving_bars = scan_net.draw_epoch, []

        def stop_at_the_second(*arguments):
            if moving_bars:
                raise KeyboardInterrupt
            moving_bars.append(True)
            return draw(*arguments)

        patch.setattr(scan_net, "draw_epoch", stop_at_the_second)
        ended = train("scans", folder, "--out", tmp_path / "m.onnx", *SHORT)
    assert ended.exit_code == 130
    assert ended.stderr.endswith("Give the same command again to continue after the last complete epoch.\n")
    again = train("scans", folder, "--out", tmp_path / "m.onnx", *SHORT)
    assert again.exit_code == 0
    assert [line.split(":")[0] for line in again.stderr.splitlines()] == ["epoch 2/2"]


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["textures", "--set", "sectors_per_class=9"], 2, "sectors_per_class"),
        (["scans", "here", "--set", "network.pixels=16"], 2, "network"),
        (["textures", "--tile-size", "3"], 2, "--tile-size is no option: write --set tile_size=3"),
        (["scans", ""], 2, "the path is empty"),
        (["--scans", "here"], 2, "bumpymap train scans"),
        (["scans", "nowhere"], 3, "nowhere does not exist"),
        (["scans", ".", "--set", "epochs=0"], 2, "epochs is 0"),
        (["scans", "."], 3, "holds no scans"),
    ],
)
def test_wrong_usage_is_explained(tmp_path, monkeypatch, options, code, words):
    require_torch()
    monkeypatch.chdir(tmp_path)
    result = train(*options, "--out", "m.onnx")
    assert result.exit_code == code, result.output
    assert words in result.stderr
    assert "Traceback" not in result.output
    assert list(tmp_path.iterdir()) == []


def test_missing_libraries_are_named_with_their_extra(tmp_path, monkeypatch):
    monkeypatch.setattr(train_command, "find_spec", lambda _: None)
    result = train("scans", tmp_path, "--out", tmp_path / "m.onnx")
    assert result.exit_code == 2
    assert "training needs torch and onnx. Install with: pip install 'bumpymap[learn]'" in result.stderr
