"""Start two runs with the same --out repeatedly: one completes, the other changes nothing and names the first.

python tests/benchmarks/race.py --data FOLDER [--races 20]

There are three kinds of races: two `scan`, two `map --overwrite`, and two `map` that continue an interrupted run. The
second run starts after a random delay up to the duration of a whole run. The exit code is 1 if the files differ from
those of a single run, both runs fail, or the losing run does not name the process of the other.
"""

import argparse
import hashlib
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

SURVEY = Path(__file__).resolve().parents[2] / "sample_data" / "quarry.laz"
_TIMED = ("run.json", "scan.json")
_FRAMES, _RETURNS = 6, 60_000
_KINDS = ("scan", "map --overwrite", "map again")


def make_frames(folder: Path) -> Path:
    """Write scans of rolling ground."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(_FRAMES):
        rng = np.random.default_rng(number)
        x, y = rng.uniform(-40, 40, (2, _RETURNS))
        z = -1.5 + 0.1 * np.sin(x) * np.cos(y) + 0.01 * rng.standard_normal(_RETURNS)
        np.column_stack([x, y, z, np.ones(_RETURNS)]).astype("<f4").tofile(folder / f"{number}.bin")
    return folder


def start(words: list[str]) -> "subprocess.Popen[str]":
    """Start a run."""
    command = [str(Path(sys.executable).with_name("bumpymap")), *words, "--quiet"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def files(out: Path) -> dict[str, str]:
    """Return the checksum of each file in a folder; an empty string for files that contain times."""
    return {
        str(path.relative_to(out)): "" if path.name in _TIMED else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file()
    }


def lone_run(words: list[str], out: Path) -> tuple[float, dict[str, str]]:
    """Do a single run; return its duration, s, and the checksums of its files."""
    begin = time.perf_counter()
    run = start([*words, "--out", str(out)])
    output, _ = run.communicate()
    if run.returncode:
        sys.exit(f"a single run fails: {output}")
    return time.perf_counter() - begin, files(out)


def killed_run(words: list[str], out: Path, delay: float) -> None:
    """Start a run and kill it after ``delay`` seconds."""
    run = start([*words, "--out", str(out)])
    time.sleep(delay)
    run.send_signal(signal.SIGKILL)
    run.communicate()


def race(words: list[str], out: Path, delay: float, wanted: dict[str, str]) -> tuple[list[str], str]:
    """Race two runs; return the faults and a description of the outcome."""
    runs = [start([*words, "--out", str(out)])]
    time.sleep(delay)
    runs.append(start([*words, "--out", str(out)]))
    output = [run.communicate()[0] for run in runs]
    codes = [run.returncode for run in runs]
    faults = []
    if 0 not in codes:
        faults.append(f"both fail: {output}")
    if files(out) != wanted:
        faults.append(f"{len(set(wanted.items()) ^ set(files(out).items()))} files differ from those of a single run")
    for own, other, code, text in zip(runs, reversed(runs), codes, output, strict=True):
        if code and f"pid {other.pid} on" not in text and "already holds" not in text:
            faults.append(f"the losing run {own.pid} does not name the other: {text}")
        if "Traceback" in text:
            faults.append(f"a traceback: {text}")
    return faults, f"exit codes {codes[0]} and {codes[1]}"


def main() -> None:
    """Run the races."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder for frames and layers")
    parser.add_argument("--races", type=int, default=20, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    draw = random.Random(given.seed)
    frames = make_frames(given.data / "frames")
    bad = 0
    for kind in _KINDS:
        name, *option = kind.split()
        words = (
            ["scan", str(frames), "--method", "filter"] if name == "scan" else ["map", str(SURVEY), "--threads", "1"]
        )
        out = given.data / "out"
        shutil.rmtree(out, ignore_errors=True)
        whole, wanted = lone_run(words, out)
        wrong = 0
        for number in range(given.races):
            if option != ["--overwrite"]:
                shutil.rmtree(out, ignore_errors=True)
            if option == ["again"]:
                killed_run(words, out, draw.uniform(0.3, 1.0) * whole)
            faults, ended = race(
                [*words, *(each for each in option if each != "again")],
                out,
                draw.choice((0.0, draw.uniform(0, whole))),
                wanted,
            )
            wrong += bool(faults)
            sys.stderr.write(f"{kind} {number + 1:2}: {ended}; {'; '.join(faults) or 'whole'}\n")
        print(f"two {kind}: {given.races - wrong} of {given.races} races end with the files of a single run")
        bad += wrong
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
