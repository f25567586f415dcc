"""Write scans in the folder layout of RELLIS-3D, which the training reads."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from bumpymap.lab.worlds.scans.lidar import Sensor, SimulatedScan, draw_sensor, simulate_scan
from bumpymap.lab.worlds.scans.scene import make_scene

POINTS = "os1_cloud_node_kitti_bin"
"""Subfolder of a sequence with points: little-endian float32 x, y, z, intensity."""
LABELS = "os1_cloud_node_semantickitti_label_id"
"""Subfolder of a sequence with labels: little-endian uint32, one per point."""


def write_frame(sequence: Path, number: int, scan: SimulatedScan) -> None:
    """Write one scan as frame ``number`` of a sequence's folder."""
    name = f"{number:06d}"
    rows = np.column_stack([scan.points, scan.intensity]).astype("<f4")
    for folder, suffix, values in ((POINTS, ".bin", rows), (LABELS, ".label", scan.label.astype("<u4"))):
        (sequence / folder).mkdir(parents=True, exist_ok=True)
        values.tofile((sequence / folder / name).with_suffix(suffix))


def write_folder(
    root: Path, seed: int, scenes: Iterable[int], sequence: str = "00000", sensor: Sensor | None = None
) -> Path:
    """Simulate scans and write them as one sequence.

    Parameters
    ----------
    root : Path
        A folder ``Rellis-3D`` is made in it.
    seed : int
        Seed of the scenes.
    scenes : ints
        Numbers of the scenes, one frame each.
    sequence : str
        Name of the sequence's folder.
    sensor : Sensor, optional
        None draws a random sensor for each scene.

    Returns
    -------
    Path
        The folder ``Rellis-3D``, for ``bumpymap train --scans``.
    """
    folder = root / "Rellis-3D"
    for number, index in enumerate(scenes):
        used = draw_sensor(np.random.default_rng([seed, index, 2])) if sensor is None else sensor
        write_frame(folder / sequence, number, simulate_scan(make_scene(seed, index), used, index))
    return folder
