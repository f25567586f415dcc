"""The networks of textures and of scans: what they learn from, as data sets lay it out, and training in seconds."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_drives import POINTS, ring_of_ground, write_rellis
from numpy.testing import assert_allclose, assert_array_equal
from small_surveys import run

from bumpymap.core import BadInputError, Scan, UsageError
from bumpymap.lab import LABEL_SETS, NetworkSettings, ScanTrainSettings, TrainSettings
from bumpymap.rating.textures import TextureModel, infer
from bumpymap.scan import CHANNELS, MEASURES, learned

torch = pytest.importorskip("torch", reason="torch comes with the extra 'learn'")
pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")

from bumpymap.lab.train import scan_net, textures  # noqa: E402
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


CLASSES = LABEL_SETS["rellis"].class_of
SMALL_SCANS = ScanTrainSettings(epochs=2, sectors_per_class=48, batch=32)


def _ring(label, rough, level=0.0):
    """Ground between 5 and 11 m, of one label, as rough as it is told [m]."""
    return Scan(ring_of_ground(rough, level).astype(np.float32), None, np.full(8000, label, np.uint16))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_rellis(tmp_path_factory.mktemp("rellis") / "Rellis-3D")


@pytest.mark.parametrize("label", [3, 19, 4])
def test_the_most_frequent_label_decides_the_class(label):
    sectors = scan_net.labelled_sectors(_ring(label, 0.01))
    assert len(sectors.class_id) == 96
    assert (sectors.class_id == CLASSES[label]).all()
    assert sectors.patches.shape == (96, CHANNELS, 15, 15)
    assert sectors.measures.shape == (96, len(MEASURES))


def test_crowns_over_the_ground_are_bushes_and_trunks_are_not():
    floor = _ring(3, 0.001, -1.5)
    rng = np.random.default_rng(2)
    height = np.repeat([0.5, 4.0], 4000)
    above = floor.points + np.column_stack([np.zeros((8000, 2)), height]).astype(np.float32)
    label = np.full(8000, 4, np.uint16)
    points = np.concatenate([floor.points, above[rng.permutation(8000)]])
    found = scan_net.crowns_as_bushes(Scan(points, None, np.concatenate([floor.label, label])))
    up = points[8000:, 2] + 1.5
    assert (found.label[:8000] == 3).all()
    assert (found.label[8000:][up < 1] == 4).mean() > 0.99
    assert (found.label[8000:][up > 3] == 19).mean() > 0.99


def test_a_folder_of_the_data_set_is_found_and_split_by_time(folder):
    learn, unseen = scan_net.folder_frames(folder)
    assert [path.stem for path in learn] == ["000000", "000001", "000002", "000003", "000004", "000000"]
    assert [path.stem for path in unseen] == ["000005", "000001"]
    assert scan_net.folder_frames(folder.parent) == (learn, unseen)
    assert len(scan_net.folder_frames(folder / "00000")[0]) == 5
    assert not set(learn) & set(unseen)


def test_folders_without_frames_or_labels_are_refused(folder, tmp_path):
    with pytest.raises(BadInputError, match="does not exist"):
        scan_net.folder_frames(tmp_path / "nowhere")
    source = folder / "00000" / POINTS / "000000.bin"
    lonely = tmp_path / "000000.bin"
    lonely.write_bytes(source.read_bytes())
    with pytest.raises(BadInputError, match="training needs 2 or more"):
        scan_net.folder_frames(tmp_path)
    with pytest.raises(BadInputError, match="has no label file"):
        scan_net.folder_sectors([lonely])
    np.full(len(np.fromfile(source, "<f4")) // 4, 7, "<u4").tofile(tmp_path / "000000.label")
    with pytest.raises(BadInputError, match="ids of RELLIS-3D"):
        scan_net.folder_sectors([lonely])


def _sectors(seed, each=60):
    """Three kinds of relief: level, waves, walls."""
    rng = np.random.default_rng(seed)
    class_id = np.repeat(np.arange(3), each)
    shape = (len(class_id), CHANNELS, 15, 15)
    column = np.arange(15)
    wave = np.sin(column[None] * rng.uniform(1, 2, (len(class_id), 1)) + rng.uniform(0, 6, (len(class_id), 1)))
    wall = np.sign(column[None] - rng.uniform(4, 10, (len(class_id), 1)))
    relief = np.choose(class_id[:, None], [0 * wave, wave, wall])[:, None, None, :]
    patches = (relief + rng.normal(0, 0.2, shape)).astype(np.float32)
    measures = rng.normal(0, 1, (len(class_id), len(MEASURES))).astype(np.float32)
    return scan_net.Sectors(patches, measures, class_id)


def test_a_short_training_of_scans_learns():
    reports = []
    net = scan_net.train(
        ScanTrainSettings(epochs=4, sectors_per_class=150, batch=24), _sectors(1, 150), None, reports.append
    )
    assert [report.epoch for report in reports] == [1, 2, 3, 4]
    assert reports[-1].loss < 0.6 * reports[0].loss
    scores = scan_net.evaluate(net, _sectors(2), 7)
    assert scores.every.right > 0.9
    assert (scores.every.count, scores.scans) == (180, 7)


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    scan_net.train(replace(SMALL_SCANS, epochs=1), _sectors(1), tmp_path / "c")
    with pytest.raises(UsageError, match=r"epochs 1 \(now 2\)"):
        scan_net.train(SMALL_SCANS, _sectors(1), tmp_path / "c")
    with pytest.raises(UsageError, match="sectors"):
        scan_net.train(replace(SMALL_SCANS, epochs=1), _sectors(1, 61), tmp_path / "c")
    (tmp_path / "c").write_bytes(b"something else")
    with pytest.raises(UsageError, match="cannot be read"):
        scan_net.train(SMALL_SCANS, _sectors(1), tmp_path / "c")


def test_onnx_of_sectors_says_what_torch_says():
    net = scan_net.train(replace(SMALL_SCANS, epochs=1), _sectors(1))
    with torch.no_grad():
        for module in net.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.running_mean.uniform_(-0.2, 0.2)
                module.weight.uniform_(0.5, 2.0)
                module.bias.uniform_(-0.5, 0.5)
        net.head.bias.uniform_(-1.0, 1.0)
    sectors = _sectors(3, 33)
    content = scan_net.to_onnx(net, {})
    said = learned.infer(content, {"patches": sectors.patches, "measures": sectors.measures})
    assert_allclose(
        said, predict(net, torch.from_numpy(sectors.patches), torch.from_numpy(sectors.measures)), atol=2e-5
    )
    alone = learned.infer(content, {"patches": sectors.patches[7:8], "measures": sectors.measures[7:8]})
    assert_array_equal(alone[0], said[7])  # whatever stands beside it
