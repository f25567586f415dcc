"""Points of a sensor that moves while it scans, as it sees them at the time of the frame: deskewing."""

from dataclasses import replace
from math import ceil

import numpy as np

from bumpymap.core import PoseTrack, Scan, loops

_STEP_S = 1e-3
"""Interval at which poses are computed. Points between them move along lines: at 3 rad/s, 0.1 mm off at 100 m."""


def deskew(scan: Scan, motion: PoseTrack) -> Scan:
    """Move the points of a scan to where they are seen from the pose at the time of the frame.

    ``scan``: with the time of each point; ``motion``: poses of the sensor; time 0 is that of the frame. Returns the
    same scan if it has no times, or if the poses do not cover them.
    """
    if scan.time is None or not len(scan.points):
        return scan
    start, end = float(scan.time.min()), float(scan.time.max())
    times = np.linspace(start, end, max(ceil((end - start) / _STEP_S), 1) + 1)
    if not motion.covers(np.append(times, 0.0)).all():
        return scan
    poses = motion.at(np.append(times, 0.0))
    relative = np.linalg.inv(poses[-1]) @ poses[:-1]
    moved = np.empty_like(scan.points)
    step = max(end - start, _STEP_S) / (len(times) - 1)
    transforms = np.ascontiguousarray(relative[:, :3])  # at times start, start + step and so on
    loops.move_points(scan.points, scan.time, transforms, start, step, moved)
    return replace(scan, points=moved)
