"""Ground and obstacles of real labelled frames."""

from collections import Counter

import numpy as np
import pytest

from bumpymap.core import ClassedSectors
from bumpymap.lab.evaluate.scans import ground_score, labels_of, mean_ground, obstacle_score
from bumpymap.readers import find_frames, read_scan
from bumpymap.scan import polar_sectors

FOLDERS = {"kitti_labelled": 0.975, "solid_state_labelled": 0.94}


@pytest.fixture(scope="module", params=FOLDERS)
def seen(request, shared_data):
    """Folder, label set, scans with their sectors."""
    frames = find_frames([shared_data / "scans" / request.param])
    scans = [read_scan(frame) for frame in frames]
    return request.param, labels_of(frames, None), [(scan, polar_sectors(scan)) for scan in scans]


def test_labels_are_told_by_their_ids(seen):
    folder, labels, _ = seen
    assert labels.name == {"kitti_labelled": "kitti", "solid_state_labelled": "semantic-kitti"}[folder]


def test_ground_is_found(seen):
    folder, labels, scans = seen
    scores = [ground_score(scan, stack.point_ground, labels) for scan, stack in scans]
    assert mean_ground(scores)["f1"] > FOLDERS[folder]
    assert min(score["f1"] for score in scores) > 0.9


def test_obstacles_lie_in_sectors_that_say_so(seen):
    _, labels, scans = seen
    total = Counter()
    for scan, stack in scans:
        smooth = np.where(stack.traversable, 0, 255).astype(np.uint8)  # the flag alone, without the help of classes
        total.update(obstacle_score(scan, ClassedSectors(stack, smooth, None, "learned"), labels))
    assert total["points"] > 4000
    assert total["in_free"] < 0.05 * total["points"] < total["in_free_class"]
