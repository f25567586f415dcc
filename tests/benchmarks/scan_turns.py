"""Measure how classes and ground of scans change with the order, heading and noise of points, and how often they agree
with labels.

    python tests/benchmarks/scan_turns.py FRAME... [--method learned] [--labels kitti]

Each frame is classified as it is, shuffled, turned by 37 and 180 degrees, mirrored, and with noise of 5 mm. Printed for
each are the shares of points of another class (none is one too) and ground; for frames with labels, the share of the
points with a class whose label says so, the mean of the recalls, and F1 of the ground.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from bumpymap.core import NOT_TRAVERSABLE
from bumpymap.lab.evaluate import ground_score, labels_of
from bumpymap.readers import read_scan
from bumpymap.scan import ScanClassifier


def changes(points):
    """Yield names, changed points (n, 3), and the rows that they had (n,)."""
    rng, rows = np.random.default_rng(0), np.arange(len(points))
    yield "as it is", points, rows
    order = rng.permutation(len(points))
    yield "shuffled", points[order], order
    for degrees in (37, 180):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        yield f"turned {degrees}", (points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])).astype(np.float32), rows
    yield "mirrored", points * np.float32([1, -1, 1]), rows
    yield "noise 5 mm", points + (0.005 * rng.standard_normal(points.shape)).astype(np.float32), rows


def recalls(found, truth):
    """Return the share of points with the class of their label, and the mean of the shares by class."""
    judged = (truth >= 0) & (found != NOT_TRAVERSABLE)
    right = found[judged] == truth[judged]
    return right.mean(), np.mean([right[truth[judged] == each].mean() for each in np.unique(truth[judged])])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path, nargs="+")
    parser.add_argument("--method", default="learned")
    parser.add_argument("--labels", help="the label set; found where left out")
    given = parser.parse_args()
    classify, sums = ScanClassifier(method=given.method), {}
    for frame in given.frames:
        scan, labels = read_scan(frame), None
        if scan.label is not None:
            labels = labels_of([frame], given.labels)
        truth = None if labels is None else labels.classes_of(scan.label & 0xFFFF)
        for name, points, rows in changes(scan.points):
            start = time.process_time()
            result = classify(points)
            spent = time.process_time() - start
            found, ground = np.empty((2, len(rows)), np.uint8)
            found[rows], ground[rows] = result.point_class, result.sectors.sectors.point_ground
            if name == "as it is":
                before = found, ground
            figures = [(found != before[0]).mean(), (ground != before[1]).mean(), np.nan, np.nan, np.nan]
            if truth is not None:
                score = ground_score(scan, ground.astype(bool), labels)
                figures[2:] = [*recalls(found, truth), score["f1"]]
            sums.setdefault((str(frame.parent.name), name), []).append([*figures, 1000 * spent])
    heads = ("class %", "ground %", "right %", "recalls %", "F1 %", "CPU ms")
    print(f"{'frames':22}{'change':12}" + "".join(f"{head:>10}" for head in heads))
    for (folder, name), rows in sums.items():
        shown = np.mean(rows, axis=0) * [100, 100, 100, 100, 100, 1]
        print(f"{folder:22}{name:12}" + "".join(f"{value:10.2f}" for value in shown))


if __name__ == "__main__":
    main()
