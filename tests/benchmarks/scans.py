"""Measure `scan`: frames a second; how classes and ground change with the points, and how often they agree with labels.

    python tests/benchmarks/scans.py --data FOLDER [--method learned]
    python tests/benchmarks/scans.py FRAME... [--method learned] [--labels kitti]

Frames a second: only the table, everything, and everything with pictures. One scan of a made-up yard is simulated with
open3d; each frame is this scan turned, with its own noise, 124,000 points. Runs with different numbers of threads
alternate, and the best round of each counts. Printed are frames a second of wall time (stage ``scan`` of scan.json),
processor time per frame and peak memory.

Of given frames, each is classified as it is, shuffled, turned by 37 and 180 degrees, mirrored, and with noise of 5 mm.
Printed for each are the shares of points of another class (none is one too) and ground; for frames with labels, the
share of the points with a class whose label says so, the mean of the recalls, and F1 of the ground.
"""

import argparse
import json
import shutil
import sys
import time
from pathlib import Path

import numpy as np
from run import BUMPYMAP, Sample, run_timed

sys.path.append(str(Path(__file__).resolve().parents[2] / "docs" / "models"))

_POINTS, _FRAMES, _ROUNDS, _THREADS = 124_000, 100, 2, (1, 2)
_KINDS = {"table": ("--set", "products=table"), "everything": (), "everything, all pictures": ("--pictures", "1")}


def make_frames(folder: Path, count: int) -> Path:
    """Write the frames as KITTI-style files, unless they are there."""
    from scan_scenes.lidar import SENSORS, simulate_scan
    from scan_scenes.scene import make_scene

    if len(list(folder.glob("*.bin"))) == count:
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    points = simulate_scan(make_scene(0, 0, "yard"), SENSORS["64_down"], 0).points
    for number in range(count):
        rng = np.random.default_rng(number)
        seen = points[np.sort(rng.choice(len(points), _POINTS))] + 0.01 * rng.standard_normal((_POINTS, 3))
        turn = rng.uniform(0.0, 2.0 * np.pi)
        x, y = seen[:, :2] @ [[np.cos(turn)], [-np.sin(turn)]], seen[:, :2] @ [[np.sin(turn)], [np.cos(turn)]]
        np.column_stack([x, y, seen[:, 2], np.full(_POINTS, 0.5)]).astype("<f4").tofile(folder / f"{number:06d}.bin")
    return folder


def measure(frames: Path, out: Path, options: tuple[str, ...], threads: int) -> tuple[float, Sample]:
    """Scan the frames; return the seconds of the frames, and the whole command."""
    shutil.rmtree(out, ignore_errors=True)
    command = [BUMPYMAP, "scan", str(frames), "--out", str(out), "--set", f"threads={threads}", "--quiet", *options]
    sample = run_timed(command)
    if sample.exit_code:
        sys.exit(f"{' '.join(command)}: {sample.stderr_tail}")
    return json.loads((out / "scan.json").read_text(encoding="utf-8"))["seconds"]["scan"], sample


def print_speed(given) -> None:
    """Run all kinds with all numbers of threads, and print a table."""
    frames = make_frames(given.data / "frames", _FRAMES)
    print(f"{'products':26} {'threads':>7} {'frames/s':>9} {'CPU ms/frame':>13} {'peak MB':>8}")
    for kind, options in _KINDS.items():
        best: dict[int, tuple[float, Sample]] = {}
        for _ in range(_ROUNDS):
            for threads in _THREADS:
                found = measure(frames, given.data / "out", ("--method", given.method, *options), threads)
                best[threads] = min(best.get(threads, found), found, key=lambda one: one[0])
        for threads, (seconds, sample) in best.items():
            rate, each = _FRAMES / seconds, 1000.0 * sample.cpu / _FRAMES
            print(f"{kind:26} {threads:7} {rate:9.1f} {each:13.1f} {sample.peak / 1e6:8.0f}")


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
    from bumpymap.core import NOT_TRAVERSABLE

    judged = (truth >= 0) & (found != NOT_TRAVERSABLE)
    right = found[judged] == truth[judged]
    return right.mean(), np.mean([right[truth[judged] == each].mean() for each in np.unique(truth[judged])])


def print_changes(given):
    """Print a line for each folder of frames and each change."""
    from bumpymap.lab.evaluate import ground_score, labels_of
    from bumpymap.readers import read_scan
    from bumpymap.scan import ScanClassifier

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


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path, nargs="*")
    parser.add_argument("--data", type=Path, help="folder for simulated frames and the output: their speed")
    parser.add_argument("--method", default="learned")
    parser.add_argument("--labels", help="the label set; found where left out")
    given = parser.parse_args()
    if not given.frames and not given.data:
        parser.error("give frames, or --data FOLDER")
    print_changes(given) if given.frames else print_speed(given)


if __name__ == "__main__":
    main()
