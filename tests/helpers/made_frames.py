"""Frames of a scanner over made-up ground, as files."""

import numpy as np

POINTS, LABELS = "os1_cloud_node_kitti_bin", "os1_cloud_node_semantickitti_label_id"
"""Folders of a sequence of RELLIS-3D."""


def write_bin(path, points):
    """Write points (n, 3) m, of one intensity, as KITTI lays them out."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.column_stack([points, np.full(len(points), 0.5)]).astype("<f4").tofile(path)
    return path


def churned_field(seed, count=60_000):
    """Points of a field around a sensor, smooth on the right and churned on the left, (n, 3) m."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-18, 18, (count, 2))
    churned = np.where(place[:, 1] > 0, 0.3 * rng.uniform(-1, 1, count), 0)
    return np.column_stack([place, -1.5 + rng.normal(0, 0.01, count) + churned])


def ring_of_ground(rough, level=-1.5, count=8000):
    """Points of ground between 5 and 11 m around a sensor, as rough as it is told [m], (n, 3) m."""
    rng = np.random.default_rng(1)
    away, turn = rng.uniform(5, 11, count), rng.uniform(0, 2 * np.pi, count)
    return np.column_stack([away * np.cos(turn), away * np.sin(turn), rng.normal(level, rough, count)])


def write_rellis(root):
    """Two sequences in the layout of RELLIS-3D, each frame of grass, bushes or trees alone; returns their folder."""
    for sequence, count in (("00000", 6), ("00003", 2)):
        for number in range(count):
            label, rough = ((3, 0.01), (19, 0.1), (4, 0.4))[number % 3]
            points = write_bin(root / sequence / POINTS / f"{number:06d}.bin", ring_of_ground(rough))
            labels = root / sequence / LABELS / f"{points.stem}.label"
            labels.parent.mkdir(exist_ok=True)
            np.full(8000, label, "<u4").tofile(labels)
    return root
