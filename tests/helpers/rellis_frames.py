"""Frames laid out as in the data set RELLIS-3D."""

import numpy as np

POINTS, LABELS = "os1_cloud_node_kitti_bin", "os1_cloud_node_semantickitti_label_id"


def write_frame(sequence, number, points, labels):
    """Write points (n, 3) and their labels (n,) as frame ``number`` of the folder of a sequence."""
    rows = np.column_stack([points, np.ones(len(points))]).astype("<f4")
    for folder, suffix, values in ((POINTS, ".bin", rows), (LABELS, ".label", labels.astype("<u4"))):
        (sequence / folder).mkdir(parents=True, exist_ok=True)
        values.tofile(sequence / folder / f"{number:06d}{suffix}")
