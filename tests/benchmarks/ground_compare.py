"""Compare the ground of labelled scans with that of Patchwork++: same frames, same run, one thread.

    pip install pypatchworkpp
    python tests/benchmarks/ground_compare.py FOLDER_OF_LABELLED_FRAMES...

Patchwork++ runs with its default parameters and the height of the sensor, which it needs to be told: here that of the
labelled ground near the sensor. Its time is that of finding ground; ours includes normals, heightmaps and measures.
"""

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Scan
from bumpymap.lab import LabelSet
from bumpymap.lab.evaluate.scans import ground_score, labels_of
from bumpymap.readers import find_frames, read_scan
from bumpymap.scan import polar_sectors

_NEAR_M = 15.0


def ours(scan: Scan) -> NDArray[np.bool_]:
    """Return which points are ground by bumpymap."""
    return polar_sectors(scan).point_ground


def theirs(scan: Scan, height_m: float) -> NDArray[np.bool_]:
    """Return which points are ground by Patchwork++."""
    import pypatchworkpp

    settings = pypatchworkpp.Parameters()
    settings.sensor_height = height_m
    estimate = pypatchworkpp.patchworkpp(settings)
    intensity = np.zeros(len(scan.points), np.float32) if scan.intensity is None else scan.intensity
    estimate.estimateGround(np.column_stack([scan.points, intensity]).astype(np.float32))
    ground = np.zeros(len(scan.points), np.bool_)
    ground[estimate.getGroundIndices()] = True
    return ground


def sensor_height(scan: Scan, labels: LabelSet) -> float:
    """Return the height of the sensor above the labelled ground near it, m."""
    near = (np.hypot(scan.points[:, 0], scan.points[:, 1]) < _NEAR_M) & labels.is_ground(scan.label)
    return -float(np.median(scan.points[near, 2]))


def timed(find: Callable[[], NDArray[np.bool_]], repeats: int) -> float:
    """Return the median time of a call, ms."""
    spent = []
    for _ in range(repeats):
        begin = time.perf_counter_ns()
        find()
        spent.append(time.perf_counter_ns() - begin)
    return float(np.median(spent)) / 1e6


def main() -> None:
    """Print a table with one row per frame."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--labels", help="label set of all folders [default: by the ids of each]")
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args()
    lines = [
        "| frame | bumpymap P / R / F1 | Patchwork++ P / R / F1 | difference of F1 | bumpymap ms | Patchwork++ ms |"
    ]
    lines.append("|---|---|---|---|---|---|")
    worse = 0
    for folder in given.folders:
        frames = find_frames([folder])
        labels = labels_of(frames, given.labels)
        if labels is None:
            raise SystemExit(f"{folder} has no labels")
        for frame in frames:
            scan = read_scan(frame)
            height = sensor_height(scan, labels)
            finders = (lambda scan=scan: ours(scan), lambda scan=scan, height=height: theirs(scan, height))
            scores = [ground_score(scan, find(), labels) for find in finders]
            cells = [f"{s.precision:.3f} / {s.recall:.3f} / {s.f1:.3f}" for s in scores]
            times = [f"{timed(find, given.repeats):.1f}" for find in finders]
            difference = scores[0].f1 - scores[1].f1
            worse += not (math.isfinite(difference) and difference >= 0)
            lines.append(f"| {frame.stem} | {cells[0]} | {cells[1]} | {difference:+.3f} | {times[0]} | {times[1]} |")
    print("\n".join(lines))
    print(f"\nbumpymap is worse on {worse} frame(s)")


if __name__ == "__main__":
    main()
