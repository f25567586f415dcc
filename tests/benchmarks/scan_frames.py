"""Measure how many frames a second `bumpymap scan` does: only the table, everything, and everything with pictures.

python tests/benchmarks/scan_frames.py --data FOLDER [--method learned]

One scan of a made-up yard is simulated with open3d; each frame is this scan turned, with its own noise, 124,000
points. Runs with different numbers of threads alternate, and the best round of each counts. Printed are frames a second
of wall time (stage ``scan`` of scan.json), processor time per frame and peak memory.
"""

import argparse
import json
import shutil
import sys
from pathlib import Path

import numpy as np
from run import Sample, run_timed

sys.path.append(str(Path(__file__).resolve().parents[1] / "worlds"))

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
    program = str(Path(sys.executable).with_name("bumpymap"))
    command = [program, "scan", str(frames), "--out", str(out), "--set", f"threads={threads}", "--quiet", *options]
    sample = run_timed(command)
    if sample.exit_code:
        sys.exit(f"{' '.join(command)}: {sample.stderr_tail}")
    return json.loads((out / "scan.json").read_text(encoding="utf-8"))["seconds"]["scan"], sample


def main() -> None:
    """Run all kinds with all numbers of threads, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder for the frames and the output")
    parser.add_argument("--method", default="learned")
    given = parser.parse_args()
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


if __name__ == "__main__":
    main()
