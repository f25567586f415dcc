"""The texture network: the patches it learns from, and training in seconds."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from bumpymap.cli import main
from bumpymap.core.errors import OutputError
from bumpymap.core.shared_kernels import fill_holes as fill_holes_of_features
from bumpymap.lab.settings import NetworkSettings, TrainSettings
from bumpymap.lab.train import textures
from bumpymap.rating import make_textures
from bumpymap.rating.textures import TextureModel, infer

torch = pytest.importorskip("torch", reason="torch comes with the extra 'learn'")
pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")

from bumpymap.lab.train.textures import predict, score, to_onnx, train  # noqa: E402

pytestmark = pytest.mark.slow
SMALL = TrainSettings(epochs=2, patches_per_texture=16, batch=32)


@pytest.fixture
def patches():
    return make_textures("low_noise", 30, np.random.default_rng(0))


def test_rotation_and_blur_agree_with_scipy_inside(patches):
    ours = textures.rotate(patches, np.full(30, np.radians(33.0)))
    theirs = ndimage.rotate(patches, 33.0, axes=(2, 1), reshape=False, order=1, mode="reflect")
    assert_allclose(ours[:, 4:11, 4:11], theirs[:, 4:11, 4:11], atol=1e-5)
    theirs = np.stack([ndimage.gaussian_filter(patch, 0.7, truncate=6) for patch in patches])
    assert_allclose(textures.blur(patches, np.full(30, 0.7))[:, 5:10, 5:10], theirs[:, 5:10, 5:10], atol=1e-4)
    assert_allclose(textures.blur(np.ones((1, 15, 15)), np.array([2.0])), 1)


def test_holes_are_filled_as_the_features_fill_them(patches):
    holed = textures.punch_holes(patches, np.full(30, 0.6), np.full(30, 2.5), np.random.default_rng(6))
    expected = holed.copy()
    for patch in expected:
        assert fill_holes_of_features(patch, 15, np.empty(patch.size, np.int32), np.empty(patch.size)) == 0
    assert_allclose(textures.fill_holes(holed), expected, rtol=1e-12)


def test_epochs_shuffle_and_alter_anew_but_repeatably():
    training = textures.training_patches(1, 40, 15)
    first, again, second = (textures.epoch_samples(training, 1, epoch) for epoch in (0, 0, 1))
    assert_array_equal(first.patches, again.patches)
    assert_array_equal(first.labels, again.labels)
    assert (np.diff(first.labels) < 0).any()
    assert_array_equal(np.sort(first.labels), np.concatenate([training.labels, [3] * 8]))
    assert np.abs(first.patches - second.patches).mean() > 0.05


def test_unseen_patches_share_none_with_training():
    training = textures.training_patches(1, 60, 15)
    unseen = textures.unseen_patches(1, 60, 15, textures.NONE)
    flat = np.concatenate([training.patches, unseen.patches]).reshape(480, -1)
    assert len(np.unique(flat, axis=0)) == 480
    assert np.abs(training.patches - unseen.patches).max(axis=(1, 2)).min() > 0.05


def bits(net):
    return {name: value.numpy().tobytes() for name, value in net.state_dict().items()}


@pytest.fixture(scope="module")
def small():
    return train(SMALL)


def test_a_short_training_learns():
    reports = []
    net = train(TrainSettings(epochs=4, patches_per_texture=250, batch=32), progress=reports.append)
    assert [report.epoch for report in reports] == [1, 2, 3, 4]
    assert reports[-1].loss < 0.5 * reports[0].loss
    assert score(net, textures.unseen_patches(1, 100, 15)).right > 0.8


def test_the_seed_decides_every_bit_and_a_broken_training_goes_on_to_the_same(small, tmp_path):
    def interrupt(report):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(SMALL, tmp_path / "net.checkpoint", interrupt)
    reports = []
    assert bits(train(SMALL, tmp_path / "net.checkpoint", reports.append)) == bits(small)
    assert [report.epoch for report in reports] == [2]
    assert bits(train(replace(SMALL, seed=2)))["conv1.weight"] != bits(small)["conv1.weight"]


@pytest.mark.parametrize("pixels", [pytest.param(9, marks=pytest.mark.later), 15])
def test_onnx_says_what_torch_says(pixels):
    net = train(replace(SMALL, epochs=1, network=NetworkSettings(pixels=pixels)))
    with torch.no_grad():
        net.norm2.running_mean.uniform_(-0.1, 0.1)
        net.norm4.weight.uniform_(0.5, 2.0)
        net.norm5.running_mean.uniform_(-0.1, 0.1)
        net.head.bias.uniform_(-1.0, 1.0)
    patches = textures.unseen_patches(3, 100, pixels).patches
    model = TextureModel(to_onnx(net, {}), {}, 3.0, pixels)
    assert_allclose(infer(model, patches), predict(net, torch.from_numpy(patches)[:, None]), atol=2e-5)


def test_command_writes_model_and_card(tmp_path, monkeypatch):
    monkeypatch.setattr(textures, "UNSEEN_PER_TEXTURE", 10)
    out = tmp_path / "m.onnx"
    words = ["--set", "epochs=1", "--set", "patches_per_texture=16", "--set", "seed=4", "--set", "tile_size=1.5"]
    result = CliRunner().invoke(main, ["train", "textures", "--out", str(out), *words])
    assert result.exit_code == 0, result.output
    model = TextureModel.load(out)
    assert (model.tile_size, model.pixels) == (1.5, 15)
    unseen = np.array(json.loads(model.metadata["confusion_unseen"]))
    assert unseen.sum(axis=1).tolist() == [10] * 4
    accuracy = 100 * float(model.metadata["accuracy_unseen"])
    assert accuracy == pytest.approx(100 * np.trace(unseen) / 40)
    card = (tmp_path / "m.md").read_text()
    assert all(f"{accuracy:.2f} %" in text for text in (result.output, card))
    assert model.metadata["command"] in card
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m.md", "m.onnx"]


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


@pytest.mark.parametrize(("options", "message"), [("--out=m.pt", ".onnx"), ("--set=network.pixels=5", "at least 9")])
def test_what_cannot_be_made_is_refused(tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["train", "textures", "--out", "m.onnx", options])
    assert result.exit_code == 2
    assert message in result.output
    assert list(tmp_path.iterdir()) == []
