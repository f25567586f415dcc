"""Ground and obstacles of real labelled frames."""

from collections import Counter

import numpy as np
import pytest

from bumpymap.core import ClassedSectors
from bumpymap.lab.evaluate.scans import ground_score, labels_of, mean_ground, obstacle_score
from bumpymap.readers import find_frames, read_scan
from bumpymap.scan import polar_sectors


@pytest.mark.parametrize(
    ("name", "known", "least"),
    [("kitti_labelled", "kitti", 0.975), ("solid_state_labelled", "semantic-kitti", 0.94)],
)
def test_labels_are_told_ground_is_found_and_obstacles_lie_in_sectors_that_say_so(shared_data, name, known, least):
    frames = find_frames([shared_data / "scans" / name])
    labels, ground, total = labels_of(frames, None), [], Counter()
    assert labels.name == known
    for scan in map(read_scan, frames):
        stack = polar_sectors(scan)
        ground.append(ground_score(scan, stack.point_ground, labels))
        smooth = np.where(stack.traversable, 0, 255).astype(np.uint8)  # the flag alone, without the help of classes
        total.update(obstacle_score(scan, ClassedSectors(stack, smooth, None, "learned"), labels))
    assert mean_ground(ground)["f1"] > least
    assert min(score["f1"] for score in ground) > 0.9
    assert total["points"] > 4000
    assert total["in_free"] < 0.05 * total["points"] < total["in_free_class"]
