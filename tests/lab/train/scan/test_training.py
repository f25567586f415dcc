"""Training in seconds: it learns, repeats itself, goes on after a break, and hands over what it learned."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bumpymap.core.errors import BadInputError, OutputError, UsageError

torch = pytest.importorskip("torch", reason="torch comes with the extra 'learn'")
onnx = pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")

from bumpymap.lab.settings import ScanTrainSettings  # noqa: E402
from bumpymap.lab.train.scan_net import evaluate, make_scan_model, to_onnx, train  # noqa: E402
from bumpymap.lab.train.scan_sectors import Sectors  # noqa: E402
from bumpymap.lab.train.textures import predict  # noqa: E402
from bumpymap.scan.learned import CHANNELS, MEASURES, ScanModel, infer  # noqa: E402

pytestmark = pytest.mark.slow

SMALL = ScanTrainSettings(epochs=2, sectors_per_class=48, batch=32)


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
    return Sectors(patches, measures, class_id, np.array([3, 19, 4], "i2")[class_id], class_id.astype("i2"))


def _numbers(net):
    return {name: value.numpy() for name, value in net.state_dict().items()}


def _assert_same(one, two):
    one, two = _numbers(one), _numbers(two)
    assert one.keys() == two.keys()
    for name, value in one.items():
        assert_array_equal(value, two[name], err_msg=name)


@pytest.fixture(scope="module")
def small():
    return train(SMALL, _sectors(1))


def test_a_short_training_learns():
    reports = []
    net = train(ScanTrainSettings(epochs=4, sectors_per_class=300, batch=32), _sectors(1, 200), None, reports.append)
    assert [report.epoch for report in reports] == [1, 2, 3, 4]
    assert reports[-1].loss < 0.6 * reports[0].loss
    scores = evaluate(net, _sectors(2), 7)
    assert scores.every.accuracy > 0.9
    assert scores.every.count == 180
    assert scores.scans == 7
    assert set(scores.labels) == {3, 4, 19}
    assert sum(map(sum, scores.labels.values())) == 180
    assert net.parameter_count() < 100_000


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    train(replace(SMALL, epochs=1), _sectors(1), tmp_path / "c")
    with pytest.raises(UsageError, match=r"epochs 1 \(now 2\)"):
        train(SMALL, _sectors(1), tmp_path / "c")
    with pytest.raises(UsageError, match="sectors"):
        train(replace(SMALL, epochs=1), _sectors(1, 61), tmp_path / "c")
    (tmp_path / "c").write_bytes(b"something else")
    with pytest.raises(UsageError, match="cannot be read"):
        train(SMALL, _sectors(1), tmp_path / "c")


def test_onnx_says_what_torch_says(small):
    net = train(replace(SMALL, epochs=1), _sectors(1))
    with torch.no_grad():
        for module in net.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.running_mean.uniform_(-0.2, 0.2)
                module.weight.uniform_(0.5, 2.0)
                module.bias.uniform_(-0.5, 0.5)
        net.head.bias.uniform_(-1.0, 1.0)
    sectors = _sectors(3, 33)
    content = to_onnx(net, {})
    said = infer(content, {"patches": sectors.patches, "measures": sectors.measures})
    assert_allclose(
        said, predict(net, torch.from_numpy(sectors.patches), torch.from_numpy(sectors.measures)), atol=2e-5
    )
    alone = infer(content, {"patches": sectors.patches[7:8], "measures": sectors.measures[7:8]})
    assert_array_equal(alone[0], said[7])  # whatever stands beside it


def test_the_whole_job_on_a_folder_of_the_data_set(tmp_path):
    folder = tmp_path / "Rellis-3D"
    for number in range(4):
        rng = np.random.default_rng(number)
        away, turn = np.sqrt(rng.uniform(16.0, 400.0, 9_000)), rng.uniform(0, 2 * np.pi, 9_000)
        third = (turn // (2 * np.pi / 3)).astype(int)
        z = -1.0 + np.array([0.003, 0.06, 0.4])[third] * rng.standard_normal(9_000)
        rows = np.column_stack([away * np.cos(turn), away * np.sin(turn), z, np.ones(9_000)]).astype("<f4")
        labels = np.array([10, 19, 4], "<u4")[third]
        for name, values in (("kitti_bin/{}.bin", rows), ("semantickitti_label_id/{}.label", labels)):
            path = folder / "00000" / f"os1_cloud_node_{name}".format(f"{number:06d}")
            path.parent.mkdir(parents=True, exist_ok=True)
            values.tofile(path)
    told = []
    out = tmp_path / "m.onnx"
    made = make_scan_model(SMALL, out, folder, None, lambda *numbers: told.append(numbers))
    assert told == [(1, 3), (2, 3), (3, 3), (1, 1)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["Rellis-3D", "m.md", "m.onnx"]
    model = ScanModel.load(out)
    assert model.metadata["command"].startswith("bumpymap train scans RELLIS_FOLDER --set seed=1 --set epochs=2")
    card = made.card.read_text(encoding="utf-8")
    assert f"{100 * made.evaluation.every.accuracy:.2f} % of all sectors" in card
    again = make_scan_model(SMALL, tmp_path / "n.onnx", folder)
    assert again.model.read_bytes() == out.read_bytes()


def test_bad_places_and_folders_are_refused(tmp_path):
    with pytest.raises(OutputError, match="not a writable folder"):
        make_scan_model(SMALL, tmp_path / "nowhere" / "m.onnx", tmp_path)
    with pytest.raises(BadInputError, match="holds no scans"):
        make_scan_model(SMALL, tmp_path / "m.onnx", tmp_path)
