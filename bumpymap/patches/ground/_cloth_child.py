"""The loop of a process that lets cloths fall on points, and does nothing else; see `bumpymap.patches.ground.cloth`.

A request is a ``REQUEST`` and three columns of coordinates; the answer is one byte a point, 1 where it is ground.
"""

import os
import struct
import sys

import numpy as np
from numpy.typing import NDArray

__all__ = ["REQUEST", "serve"]

REQUEST = struct.Struct("<q2d2q")
"""Points, side of a mesh of the cloth and farthest distance from it in metres, rigidness, slope_smooth."""


def serve() -> None:
    """Answer requests until there are no more."""
    # The filter tells its progress on standard output, so the answers go elsewhere.
    answers = os.fdopen(os.dup(1), "wb")
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    while len(head := sys.stdin.buffer.read(REQUEST.size)) == REQUEST.size:
        points, *settings = REQUEST.unpack(head)
        columns = np.empty((points, 3))
        for axis in range(3):
            columns[:, axis] = np.frombuffer(sys.stdin.buffer.read(8 * points), np.float64)
        answers.write(_ground(columns, *settings).data)
        answers.flush()


def _ground(
    points: NDArray[np.float64], cloth_resolution: float, class_threshold: float, rigidness: int, slope_smooth: int
) -> NDArray[np.uint8]:
    import CSF

    cloth = CSF.CSF()
    cloth.params.cloth_resolution, cloth.params.class_threshold = cloth_resolution, class_threshold
    cloth.params.rigidness, cloth.params.bSloopSmooth = rigidness, bool(slope_smooth)
    cloth.setPointCloud(points)
    ground, others = CSF.VecInt(), CSF.VecInt()
    cloth.do_filtering(ground, others, False)  # the cloth itself goes to no file
    marks = np.zeros(len(points), np.uint8)
    marks[np.asarray(ground, np.int64)] = 1
    return marks
