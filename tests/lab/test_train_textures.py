"""The texture network: the patches it learns from, and training in seconds."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from small_surveys import run

from bumpymap.lab.settings import NetworkSettings, TrainSettings
from bumpymap.lab.train import textures
from bumpymap.rating.textures import TextureModel, infer

torch = pytest.importorskip("torch", reason="torch comes with the extra 'learn'")
pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")

from bumpymap.lab.train.model_files import predict  # noqa: E402
from bumpymap.lab.train.textures import SurveyEffects, labels_of, score, surveyed, to_onnx, train  # noqa: E402

pytestmark = pytest.mark.slow
SMALL = TrainSettings(epochs=2, patches_per_texture=16, batch=32)


def test_unseen_patches_share_none_with_training():
    training, unseen = textures.shapes(1, 0, 60, 15), textures.shapes(1, 2, 60, 15)
    flat = np.concatenate([training, unseen]).reshape(480, -1)
    assert len(np.unique(flat, axis=0)) == 480
    assert np.abs(training - unseen).max(axis=(1, 2)).min() > 0.05


def test_labels_follow_the_true_relief():
    relief = np.array([0.0, 0.09, 0.2, 0.5, 1.0, 2.0, 4.0])
    table = [labels_of(np.full(7, form), relief).tolist() for form in range(4)]
    assert table == [[0, 0, 0, 1, 1, 2, 3], [0, 0, 1, 1, 1, 2, 3], [0, 0, 1, 2, 2, 2, 3], [0, 0, 1, 2, 3, 3, 3]]


def test_a_survey_measures_the_relief_and_the_noise_that_were_drawn():
    ground = textures.shapes(1, 0, 100, 15)
    form = np.repeat(np.arange(4), 100)
    still = {"waves": (1e-9, 1e-9), "strip": 0, "hole": 0, "slope": 0, "no_noise": 0}
    plain = SurveyEffects(relief=(0.5, 0.5), level=0, points=(9, 9), noise=(0.01, 0.01), **still)
    level = replace(plain, level=1)
    (_, found, _), (_, noise, labels) = (surveyed(ground, form, np.random.default_rng(3), of) for of in (plain, level))
    assert np.exp(np.median(found[:, 0])) == pytest.approx(5, rel=0.1)
    assert np.exp(np.median(noise[:, 1])) == pytest.approx(1 / 3, rel=0.15), "of ten millimetres, nine points"
    assert_array_equal(labels, 0)
    assert_array_equal(surveyed(ground, form, np.random.default_rng(3), SurveyEffects(no_noise=1))[1][:, 1:], 0)


def bits(net):
    return {name: value.numpy().tobytes() for name, value in net.state_dict().items()}


@pytest.fixture(scope="module")
def small():
    return train(SMALL)


def test_a_short_training_learns():
    reports = []
    net = train(TrainSettings(epochs=4, patches_per_texture=250, batch=32), progress=reports.append)
    assert [report.epoch for report in reports] == [1, 2, 3, 4]
    assert reports[-1].loss < 0.6 * reports[0].loss
    assert score(net, textures.unseen_samples(1, 100, 15)).right > 0.7


def test_the_seed_decides_every_bit_and_a_broken_training_goes_on_to_the_same(small, tmp_path):
    def interrupt(report):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(SMALL, tmp_path / "net.checkpoint", interrupt)
    reports = []
    assert bits(train(SMALL, tmp_path / "net.checkpoint", reports.append)) == bits(small)
    assert [report.epoch for report in reports] == [2]
    assert bits(train(replace(SMALL, seed=2)))["conv1.0.weight"] != bits(small)["conv1.0.weight"]


@pytest.mark.parametrize("pixels", [pytest.param(9, marks=pytest.mark.later), 15])
def test_onnx_says_what_torch_says(pixels):
    net = train(replace(SMALL, epochs=1, network=NetworkSettings(pixels=pixels)))
    with torch.no_grad():
        net.conv2[1].running_mean.uniform_(-0.1, 0.1)
        net.conv4[1].weight.uniform_(0.5, 2.0)
        net.conv5[1].running_mean.uniform_(-0.1, 0.1)
        net.head.bias.uniform_(-1.0, 1.0)
    patches, measures, _ = textures.unseen_samples(3, 100, pixels)
    model = TextureModel(to_onnx(net, {}), {}, 3.0, pixels)
    expected = predict(net, torch.from_numpy(patches)[:, None], torch.from_numpy(measures))
    assert_allclose(infer(model, patches, measures), expected, atol=2e-5)


def test_command_writes_a_model_with_its_scores(tmp_path, monkeypatch):
    monkeypatch.setattr(textures, "UNSEEN_PER_TEXTURE", 10)
    out = tmp_path / "m.onnx"
    words = ["--set", "epochs=1", "--set", "patches_per_texture=16", "--set", "seed=4", "--set", "tile_size=1.5"]
    result = run("train", "textures", "--out", out, *words)
    assert result.exit_code == 0, result.output
    model = TextureModel.load(out)
    assert (model.tile_size, model.pixels) == (1.5, 15)
    unseen = np.array(json.loads(model.metadata["confusion_unseen"]))
    assert unseen.sum() == 40
    accuracy = 100 * float(model.metadata["accuracy_unseen"])
    assert accuracy == pytest.approx(100 * np.trace(unseen) / 40)
    assert f"{accuracy:.2f} %" in result.output
    assert "train textures" in model.metadata["command"]
    assert [path.name for path in tmp_path.iterdir()] == ["m.onnx"]
