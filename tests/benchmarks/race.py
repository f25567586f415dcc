"""Race two runs into one --out, again and again: one does its work, the other touches nothing and names the first.

python tests/benchmarks/race.py --data FOLDER [--races 20]

Three races take turns: two `scan`, two `map --overwrite`, two `map --resume` over an interrupted run. The second
starts after a delay drawn over the time of a whole run. Exit code 1 where the files are not those of a lone run, both
fail, or the loser does not name the winner's process.
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
_KINDS = ("scan", "map --overwrite", "map --resume")


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
    """Give checksums of what is in a folder; of files with times in them the name alone."""
    return {
        str(path.relative_to(out)): "" if path.name in _TIMED else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file()
    }


def finished(words: list[str], out: Path) -> tuple[float, dict[str, str]]:
    """Do a lone run; give its time, s, and its files."""
    begin = time.perf_counter()
    run = start([*words, "--out", str(out)])
    said, _ = run.communicate()
    if run.returncode:
        sys.exit(f"a lone run fails: {said}")
    return time.perf_counter() - begin, files(out)


def broken_off(words: list[str], out: Path, delay: float) -> None:
    """Leave what a run leaves that is killed."""
    run = start([*words, "--out", str(out)])
    time.sleep(delay)
    run.send_signal(signal.SIGKILL)
    run.communicate()


def race(words: list[str], out: Path, delay: float, wanted: dict[str, str]) -> tuple[list[str], str]:
    """Let two runs race; give what is wrong, and how it ended."""
    runs = [start([*words, "--out", str(out)])]
    time.sleep(delay)
    runs.append(start([*words, "--out", str(out)]))
    said = [run.communicate()[0] for run in runs]
    codes = [run.returncode for run in runs]
    faults = []
    if 0 not in codes:
        faults.append(f"both fail: {said}")
    if files(out) != wanted:
        faults.append(f"{len(set(wanted.items()) ^ set(files(out).items()))} files differ from those of a lone run")
    for own, other, code, text in zip(runs, reversed(runs), codes, said, strict=True):
        if code and f"pid {other.pid} on" not in text and "already holds" not in text:
            faults.append(f"the loser {own.pid} does not say who won: {text}")
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
        whole, wanted = finished(words, out)
        wrong = 0
        for number in range(given.races):
            if option != ["--overwrite"]:
                shutil.rmtree(out, ignore_errors=True)
            if option == ["--resume"]:
                broken_off(words, out, draw.uniform(0.3, 1.0) * whole)
            faults, ended = race([*words, *option], out, draw.choice((0.0, draw.uniform(0, whole))), wanted)
            wrong += bool(faults)
            sys.stderr.write(f"{kind} {number + 1:2}: {ended}; {'; '.join(faults) or 'whole'}\n")
        print(f"two {kind}: {given.races - wrong} of {given.races} races end with the files of a lone run")
        bad += wrong
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
