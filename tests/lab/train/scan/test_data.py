"""Sectors to learn from: from folders as data sets lay them out, and from scenes."""

from dataclasses import fields

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rellis_folder import write_folder

from bumpymap.core.errors import BadInputError
from bumpymap.core.scan_types import PolarSettings, Scan
from bumpymap.lab.train import scan_sectors as data
from bumpymap.lab.train.scan_sectors import (
    SWAPPED_MEASURES,
    Sectors,
    crowns_as_bushes,
    draw_epoch,
    folder_frames,
    folder_sectors,
    labelled_sectors,
    overhead_sectors,
    simulated_sectors,
)
from bumpymap.lab.worlds.scans.lidar import Sensor
from bumpymap.readers import LABEL_SETS
from bumpymap.scan.learned import CHANNELS, MEASURES

pytestmark = pytest.mark.slow

CLASSES = LABEL_SETS["rellis"].class_of


@pytest.fixture(autouse=True)
def _coarse_mesh(monkeypatch):
    monkeypatch.setattr("bumpymap.lab.worlds.scans.ground.STEP", 0.04)


SMALL = Sensor(lines=32, columns=512, end_m=40.0)


def _same(one, two):
    for field in fields(Sectors):
        assert_array_equal(getattr(one, field.name), getattr(two, field.name), err_msg=field.name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("rellis")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bumpymap.lab.worlds.scans.ground.STEP", 0.04)
        write_folder(root, 3, range(6), "00000", SMALL)
        return write_folder(root, 3, range(6, 8), "00003", SMALL)


def _ring(label, z):
    """Ground between 5 and 11 m, of one label."""
    rng = np.random.default_rng(1)
    away, turn = rng.uniform(5, 11, 8000), rng.uniform(0, 2 * np.pi, 8000)
    points = np.column_stack([away * np.cos(turn), away * np.sin(turn), z(rng, 8000)]).astype(np.float32)
    return Scan(points, None, np.full(8000, label, np.uint16))


@pytest.mark.parametrize("label", [label for label, class_id in CLASSES.items() if class_id >= 0])
def test_the_most_frequent_label_decides_the_class(label):
    sectors = labelled_sectors(_ring(label, lambda rng, n: rng.normal(0, 0.01, n)))
    assert len(sectors.class_id) == 96
    assert (sectors.class_id == CLASSES[label]).all()
    assert (sectors.label == label).all()
    assert sectors.patches.shape == (96, CHANNELS, 15, 15)
    assert sectors.measures.shape == (96, len(MEASURES))


def test_crowns_over_the_ground_are_bushes_and_trunks_are_not():
    floor = _ring(3, lambda rng, n: rng.normal(-1.5, 0.001, n))
    rng = np.random.default_rng(2)
    height = np.repeat([0.5, 4.0], 4000)
    above = floor.points + np.column_stack([np.zeros((8000, 2)), height]).astype(np.float32)
    label = np.full(8000, 4, np.uint16)
    points = np.concatenate([floor.points, above[rng.permutation(8000)]])
    found = crowns_as_bushes(Scan(points, None, np.concatenate([floor.label, label])))
    up = points[8000:, 2] + 1.5
    assert (found.label[:8000] == 3).all()
    assert (found.label[8000:][up < 1] == 4).mean() > 0.99
    assert (found.label[8000:][up > 3] == 19).mean() > 0.99


def test_turned_cuts_see_the_same_ground_in_other_sectors():
    scan = _ring(3, lambda rng, n: rng.normal(0, 0.05, n))
    once, thrice = labelled_sectors(scan), labelled_sectors(scan, [(0.1, PolarSettings()), (1.0, PolarSettings())])
    assert len(thrice.class_id) == 3 * len(once.class_id)
    assert_array_equal(thrice.patches[: len(once.class_id)], once.patches)
    others = thrice.patches[len(once.class_id) :]
    assert not any((patch == others[0]).all() for patch in once.patches)
    assert_allclose(thrice.measures.mean(axis=0), once.measures.mean(axis=0), atol=0.02)


@pytest.mark.open3d
def test_a_folder_of_the_data_set_is_found_and_split_by_time(folder):
    learn, unseen = folder_frames(folder)
    assert [path.stem for path in learn] == ["000000", "000001", "000002", "000003", "000004", "000000"]
    assert [path.stem for path in unseen] == ["000005", "000001"]
    assert folder_frames(folder.parent) == (learn, unseen)
    assert len(folder_frames(folder / "00000")[0]) == 5
    assert not set(learn) & set(unseen)


@pytest.mark.open3d
def test_a_folder_gives_what_its_scenes_give(folder, monkeypatch):
    monkeypatch.setattr("bumpymap.lab.worlds.scans.lidar.draw_sensor", lambda _rng: SMALL)
    frames = [folder / "00000" / "os1_cloud_node_kitti_bin" / f"00000{k}.bin" for k in range(2)]
    told = []
    read = folder_sectors(frames, progress=lambda *numbers: told.append(numbers))
    assert told == [(1, 2), (2, 2)]
    _same(read, simulated_sectors(3, range(2)))
    assert set(read.class_id) <= {0, 1, 2}


@pytest.mark.open3d
def test_folders_without_frames_or_labels_are_refused(folder, tmp_path):
    with pytest.raises(BadInputError, match="does not exist"):
        folder_frames(tmp_path / "nowhere")
    source = folder / "00000" / "os1_cloud_node_kitti_bin" / "000000.bin"
    lonely = tmp_path / "000000.bin"
    lonely.write_bytes(source.read_bytes())
    with pytest.raises(BadInputError, match="training needs 2 or more"):
        folder_frames(tmp_path)
    with pytest.raises(BadInputError, match="has no label file"):
        folder_sectors([lonely])
    np.full(len(np.fromfile(source, "<f4")) // 4, 7, "<u4").tofile(tmp_path / "000000.label")
    with pytest.raises(BadInputError, match="ids of RELLIS-3D"):
        folder_sectors([lonely])


@pytest.mark.open3d
def test_kept_sectors_are_the_same_and_are_used(tmp_path, monkeypatch):
    monkeypatch.setattr("bumpymap.lab.worlds.scans.lidar.draw_sensor", lambda _rng: SMALL)
    first = simulated_sectors(1, [2, 3], 1, tmp_path / "keep")
    assert len(list((tmp_path / "keep").iterdir())) == 2
    monkeypatch.setattr(data, "scene_scan", None)
    _same(simulated_sectors(1, [2, 3], 1, tmp_path / "keep"), first)


def _made(counts):
    class_id = np.repeat(np.arange(3), counts)
    number = np.arange(len(class_id))
    patches = np.zeros((len(class_id), CHANNELS, 15, 15), np.float32)
    patches[:, 0, 0, 0] = number
    return Sectors(
        patches,
        np.tile(number[:, None], len(MEASURES)).astype("f4"),
        class_id,
        class_id.astype("i2"),
        class_id.astype("i2"),
    )


def test_an_epoch_is_balanced_mirrored_and_repeats_itself():
    sectors = _made([50, 7, 20])
    before = sectors.patches.copy()
    patches, measures, class_id = draw_epoch(sectors, 20, np.random.default_rng(1))
    assert np.bincount(class_id).tolist() == [20, 20, 20]
    who = measures[:, MEASURES.index("distance")].astype(int)
    often = np.bincount(who, minlength=77)
    assert often[:50].max() == 1  # enough of them: none twice
    assert set(often[50:57]) == {2, 3}
    assert (often[57:] == 1).all()
    plain, mirrored = patches[:, 0, 0, 0] == who, patches[:, 0, 0, -1] == who
    assert (plain | mirrored).all()
    assert 10 < mirrored.sum() < 50
    for one, two in zip(draw_epoch(sectors, 20, np.random.default_rng(1)), (patches, measures, class_id), strict=True):
        assert_array_equal(one, two)
    assert_array_equal(sectors.patches, before)


def test_some_measures_are_lent_and_others_never():
    _, measures, _ = draw_epoch(_made([900, 900, 900]), 900, np.random.default_rng(1))
    who = measures[:, MEASURES.index("distance")]
    for column, name in enumerate(MEASURES):
        foreign = (measures[:, column] != who).mean()
        assert 0.1 < foreign < 0.2 if name in SWAPPED_MEASURES else foreign == 0
        assert_array_equal(np.sort(measures[:, column]), np.sort(who))  # lent, not made up


def test_ground_from_above_is_half_blocks_and_none_of_it_water():
    sectors = overhead_sectors(1, [0, 5])
    assert set(sectors.class_id) == {0, 1}
    assert 0.2 < (sectors.label == 34).mean() < 0.8
    assert not np.isin(sectors.label, (6, 31)).any()
    blocks, rest = (sectors.measures[sectors.label == 34], sectors.measures[sectors.class_id == 0])
    column = MEASURES.index("residual")
    assert np.median(blocks[:, column]) > np.median(rest[:, column]) + 0.3  # more than twice as rough
    _same(overhead_sectors(1, [0, 5]), sectors)
