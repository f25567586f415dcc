"""Run the cloth simulation filter; called in a child process, see `bumpymap.patches.cloth`."""

import numpy as np


def mark_ground(
    cloth_resolution: float,
    class_threshold: float,
    rigidness: int,
    slope_smooth: bool,
    points: memoryview,
    marks: memoryview,
) -> None:
    """Mark the points that are ground.

    ``cloth_resolution``, ``class_threshold``, ``rigidness`` and ``slope_smooth``: as in ``CsfSettings``; ``points`` (n,
    3): buffer of the coordinates, m; ``marks`` (n,): output buffer: 1 for ground, else 0.
    """
    import CSF

    cloth = CSF.CSF()
    cloth.params.cloth_resolution, cloth.params.class_threshold = cloth_resolution, class_threshold
    cloth.params.rigidness, cloth.params.bSloopSmooth = rigidness, slope_smooth
    cloth.setPointCloud(np.frombuffer(points, np.float64).reshape(-1, 3))
    ground, others = CSF.VecInt(), CSF.VecInt()
    cloth.do_filtering(ground, others, False)  # False: do not write the cloth to a file
    found = np.frombuffer(marks, np.uint8)
    found[:] = 0
    found[np.asarray(ground, np.int64)] = 1
