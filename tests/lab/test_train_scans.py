"""The scan network: sectors to learn from, from folders as data sets lay them out, and training in seconds."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import POINTS, ring_of_ground, write_rellis
from numpy.testing import assert_allclose, assert_array_equal

from bumpymap.core import BadInputError, Scan, UsageError
from bumpymap.lab import LABEL_SETS, ScanTrainSettings
from bumpymap.scan.learned import CHANNELS, MEASURES, infer

torch = pytest.importorskip("torch", reason="torch comes with the extra 'learn'")
pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")

from bumpymap.lab.train import scan_net  # noqa: E402
from bumpymap.lab.train.model_files import predict  # noqa: E402
from bumpymap.lab.train.scan_net import evaluate, to_onnx, train  # noqa: E402

pytestmark = pytest.mark.slow
CLASSES = LABEL_SETS["rellis"].class_of
SMALL = ScanTrainSettings(epochs=2, sectors_per_class=48, batch=32)


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


def test_a_short_training_learns():
    reports = []
    net = train(ScanTrainSettings(epochs=4, sectors_per_class=150, batch=24), _sectors(1, 150), None, reports.append)
    assert [report.epoch for report in reports] == [1, 2, 3, 4]
    assert reports[-1].loss < 0.6 * reports[0].loss
    scores = evaluate(net, _sectors(2), 7)
    assert scores.every.right > 0.9
    assert (scores.every.count, scores.scans) == (180, 7)


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    train(replace(SMALL, epochs=1), _sectors(1), tmp_path / "c")
    with pytest.raises(UsageError, match=r"epochs 1 \(now 2\)"):
        train(SMALL, _sectors(1), tmp_path / "c")
    with pytest.raises(UsageError, match="sectors"):
        train(replace(SMALL, epochs=1), _sectors(1, 61), tmp_path / "c")
    (tmp_path / "c").write_bytes(b"something else")
    with pytest.raises(UsageError, match="cannot be read"):
        train(SMALL, _sectors(1), tmp_path / "c")


def test_onnx_says_what_torch_says():
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
