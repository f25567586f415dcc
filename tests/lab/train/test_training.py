"""Training in seconds: it learns, repeats itself, goes on after a break, and hands over what it learned."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose, assert_array_equal

from bumpymap.core.errors import OutputError

torch = pytest.importorskip("torch", reason="torch comes with the extra 'learn'")
onnx = pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")

from bumpymap.cli import main  # noqa: E402
from bumpymap.core.errors import UsageError  # noqa: E402
from bumpymap.lab.settings import NetworkSettings, TrainSettings  # noqa: E402
from bumpymap.lab.train import textures  # noqa: E402
from bumpymap.lab.train.texture_data import unseen_patches  # noqa: E402
from bumpymap.lab.train.textures import predict, score, to_onnx, train  # noqa: E402
from bumpymap.rating.textures import TextureModel, infer  # noqa: E402

pytestmark = pytest.mark.slow

SMALL = TrainSettings(epochs=2, patches_per_texture=16, batch=32)


def _numbers(net):
    return {name: value.numpy() for name, value in net.state_dict().items()}


def _assert_same(one, two):
    one, two = _numbers(one), _numbers(two)
    assert one.keys() == two.keys()
    for name, value in one.items():
        assert_array_equal(value, two[name], err_msg=name)


@pytest.fixture(scope="module")
def small():
    return train(SMALL)


@pytest.fixture
def few_scored(monkeypatch):
    monkeypatch.setattr(textures, "UNSEEN_PER_TEXTURE", 10)


def test_a_short_training_learns():
    reports = []
    settings = TrainSettings(epochs=4, patches_per_texture=250, batch=32)
    net = train(settings, progress=reports.append)
    assert [report.epoch for report in reports] == [1, 2, 3, 4]
    assert reports[-1].loss < 0.5 * reports[0].loss
    assert score(net, unseen_patches(1, 100, 15)).accuracy > 0.8
    assert net.parameter_count() < 200_000


def test_the_seed_decides_every_bit(small):
    _assert_same(train(SMALL), small)
    other = _numbers(train(replace(SMALL, seed=2)))
    assert (other["conv1.weight"] != _numbers(small)["conv1.weight"]).any()


def test_a_broken_training_goes_on_to_the_same_bits(small, tmp_path):
    checkpoint = tmp_path / "net.checkpoint"

    def pull_the_plug(report):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(SMALL, checkpoint, pull_the_plug)
    reports = []
    resumed = train(SMALL, checkpoint, reports.append)
    assert [report.epoch for report in reports] == [2]
    _assert_same(resumed, small)


def test_a_foreign_checkpoint_is_refused(tmp_path):
    (tmp_path / "c").write_bytes(b"something else")
    with pytest.raises(UsageError, match="cannot be read"):
        train(SMALL, tmp_path / "c")


@pytest.mark.parametrize("pixels", [pytest.param(9, marks=pytest.mark.later), 15])
def test_onnx_says_what_torch_says(pixels):
    settings = NetworkSettings(pixels=pixels)
    net = train(replace(SMALL, epochs=1, network=settings))
    with torch.no_grad():
        net.norm2.running_mean.uniform_(-0.1, 0.1)
        net.norm4.weight.uniform_(0.5, 2.0)
        net.norm5.running_mean.uniform_(-0.1, 0.1)
        net.head.bias.uniform_(-1.0, 1.0)
    patches = unseen_patches(3, 100, pixels).patches
    model = TextureModel(to_onnx(net, {}), {}, 3.0, pixels)
    assert_allclose(infer(model, patches), predict(net, torch.from_numpy(patches)[:, None]), atol=2e-5)


@pytest.mark.usefixtures("few_scored")
def test_command_writes_model_and_card(tmp_path):
    out = tmp_path / "m.onnx"
    argv = [
        "train",
        "textures",
        "--out",
        str(out),
        "--set",
        "epochs=1",
        "--set",
        "patches_per_texture=16",
        "--set",
        "tile_size=1.5",
        "--set",
        "seed=4",
    ]
    result = CliRunner().invoke(main, argv)
    assert result.exit_code == 0, result.output
    model = TextureModel.load(out)
    assert (model.tile_size, model.pixels) == (1.5, 15)
    unseen = np.array(json.loads(model.metadata["confusion_unseen"]))
    assert unseen.sum(axis=1).tolist() == [10] * 4
    accuracy = 100 * float(model.metadata["accuracy_unseen"])
    assert accuracy == pytest.approx(100 * np.trace(unseen) / 40)
    assert f"{accuracy:.2f} %" in result.output
    assert "altered copies" in result.output
    card = (tmp_path / "m.md").read_text()
    assert f"{accuracy:.2f} %" in card
    assert model.metadata["command"] in card
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m.md", "m.onnx"]


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--out", "m.pt"], 2, ".onnx"),
        (["--out", "m.onnx", "--set", "network.pixels=5"], 2, "at least 9"),
        (["--out", "nowhere/m.onnx"], 3, "nowhere"),
        ([], 2, "--out"),
    ],
)
def test_wrong_usage_is_explained(tmp_path, monkeypatch, options, code, message):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["train", "textures", *options])
    assert result.exit_code == code
    assert message in result.output
    assert "Traceback" not in result.output
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_nothing_but_the_checkpoint(tmp_path, monkeypatch):
    def full(descriptor):
        if Path(f"/proc/self/fd/{descriptor}").readlink().suffix == ".onnx":
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    monkeypatch.setattr(textures, "UNSEEN_PER_TEXTURE", 5)
    with pytest.raises(OutputError, match="No space left"):
        textures.make_model(TrainSettings(epochs=1, patches_per_texture=8), tmp_path / "m.onnx")
    # The training itself is kept, so that the same command can go on.
    assert [path.name for path in tmp_path.iterdir()] == ["m.onnx.checkpoint"]
