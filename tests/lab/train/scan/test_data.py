"""Sectors to learn from, from folders as data sets lay them out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rellis_frames import POINTS, write_frame

from bumpymap.core.errors import BadInputError
from bumpymap.core.scan_types import PolarSettings, Scan
from bumpymap.lab import LABEL_SETS
from bumpymap.lab.train.scan_sectors import (
    Sectors,
    crowns_as_bushes,
    draw_epoch,
    folder_frames,
    folder_sectors,
    labelled_sectors,
)
from bumpymap.scan.learned import CHANNELS, MEASURES

pytestmark = pytest.mark.slow

CLASSES = LABEL_SETS["rellis"].class_of


def _ring(label, rough, level=0.0):
    """Ground between 5 and 11 m, of one label, as rough as it is told [m]."""
    rng = np.random.default_rng(1)
    away, turn = rng.uniform(5, 11, 8000), rng.uniform(0, 2 * np.pi, 8000)
    points = np.column_stack([away * np.cos(turn), away * np.sin(turn), rng.normal(level, rough, 8000)])
    return Scan(points.astype(np.float32), None, np.full(8000, label, np.uint16))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("rellis") / "Rellis-3D"
    for sequence, count in (("00000", 6), ("00003", 2)):
        for number in range(count):
            scan = _ring(*((3, 0.01), (19, 0.1), (4, 0.4))[number % 3], -1.5)
            write_frame(root / sequence, number, scan.points, scan.label)
    return root


@pytest.mark.parametrize("label", [3, 19, 4])
def test_the_most_frequent_label_decides_the_class(label):
    sectors = labelled_sectors(_ring(label, 0.01))
    assert len(sectors.class_id) == 96
    assert (sectors.class_id == CLASSES[label]).all()
    assert (sectors.label == label).all()
    assert sectors.patches.shape == (96, CHANNELS, 15, 15)
    assert sectors.measures.shape == (96, len(MEASURES))


def test_crowns_over_the_ground_are_bushes_and_trunks_are_not():
    floor = _ring(3, 0.001, -1.5)
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
    scan = _ring(3, 0.05)
    once, thrice = labelled_sectors(scan), labelled_sectors(scan, [(0.1, PolarSettings()), (1.0, PolarSettings())])
    assert len(thrice.class_id) == 3 * len(once.class_id)
    assert_array_equal(thrice.patches[: len(once.class_id)], once.patches)
    others = thrice.patches[len(once.class_id) :]
    assert not any((patch == others[0]).all() for patch in once.patches)
    assert_allclose(thrice.measures.mean(axis=0), once.measures.mean(axis=0), atol=0.02)


def test_a_folder_of_the_data_set_is_found_and_split_by_time(folder):
    learn, unseen = folder_frames(folder)
    assert [path.stem for path in learn] == ["000000", "000001", "000002", "000003", "000004", "000000"]
    assert [path.stem for path in unseen] == ["000005", "000001"]
    assert folder_frames(folder.parent) == (learn, unseen)
    assert len(folder_frames(folder / "00000")[0]) == 5
    assert not set(learn) & set(unseen)


def test_frames_of_a_folder_give_the_sectors_of_their_scans(folder):
    frames = [folder / "00000" / POINTS / f"00000{k}.bin" for k in range(2)]
    told = []
    read = folder_sectors(frames, progress=lambda *numbers: told.append(numbers))
    assert told == [(1, 2), (2, 2)]
    made = [labelled_sectors(scan) for scan in (_ring(3, 0.01, -1.5), _ring(19, 0.1, -1.5))]
    assert_array_equal(read.patches, np.concatenate([sectors.patches for sectors in made]))
    assert_array_equal(read.class_id, np.concatenate([sectors.class_id for sectors in made]))
    assert set(read.class_id) == {0, 1}


def test_folders_without_frames_or_labels_are_refused(folder, tmp_path):
    with pytest.raises(BadInputError, match="does not exist"):
        folder_frames(tmp_path / "nowhere")
    source = folder / "00000" / POINTS / "000000.bin"
    lonely = tmp_path / "000000.bin"
    lonely.write_bytes(source.read_bytes())
    with pytest.raises(BadInputError, match="training needs 2 or more"):
        folder_frames(tmp_path)
    with pytest.raises(BadInputError, match="has no label file"):
        folder_sectors([lonely])
    np.full(len(np.fromfile(source, "<f4")) // 4, 7, "<u4").tofile(tmp_path / "000000.label")
    with pytest.raises(BadInputError, match="ids of RELLIS-3D"):
        folder_sectors([lonely])


def _made(counts):
    class_id = np.repeat(np.arange(3), counts)
    number = np.arange(len(class_id))
    patches = np.zeros((len(class_id), CHANNELS, 15, 15), np.float32)
    patches[:, 0, 0, 0] = number
    measures = np.tile(number[:, None], len(MEASURES)).astype("f4")
    return Sectors(patches, measures, class_id, class_id.astype("i2"), class_id.astype("i2"))


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
    again = draw_epoch(sectors, 20, np.random.default_rng(1))
    assert all(map(np.array_equal, again, (patches, measures, class_id)))
    assert_array_equal(sectors.patches, before)
