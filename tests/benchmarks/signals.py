"""Send signals to runs at random times and check their output: ``python tests/benchmarks/signals.py [--instants 50]``.

Prints one line for each command and signal: exit codes, and the number of runs with unexpected output. The test suite
sends signals at fixed stages; this script covers all others.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

SURVEY = Path(__file__).parents[2] / "sample_data" / "quarry.laz"
COMMANDS = {
    "map": ["map", str(SURVEY), "--out", "out"],
    "calibrate": [
        "calibrate",
        "--out",
        "c.json",
        "--set",
        "patches=2",
        "--set",
        "starts=2",
        "--set",
        "terrains=2",
        "--jobs",
        "2",
    ],
}
BAD = ("Traceback", "ignored", "Warning", "leaked", "Exception")


def run(
    command: Sequence[str], number: int, after_s: float | None, folder: Path, *, group: bool
) -> tuple[int, str, float]:
    """Run a command in a folder and send it a signal after some time; return exit code, output and duration."""
    pipe = subprocess.PIPE
    # A background job of a shell ignores SIGINT, and its child processes would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    started = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "bumpymap", *command],
        cwd=folder,
        stdout=pipe,
        stderr=pipe,
        text=True,
        start_new_session=True,
    )
    try:
        process.wait(after_s)
    except subprocess.TimeoutExpired:
        (os.killpg if group else os.kill)(process.pid, number)
    output = "".join(process.communicate(timeout=120))
    return process.returncode, output, time.perf_counter() - started


def main() -> int:
    """Run all commands; return exit code 1 if any run was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--instants", type=int, default=50)
    parser.add_argument("--only", choices=COMMANDS, action="append")
    parser.add_argument("--within", type=float, default=1e9, metavar="S", help="only in the first S seconds")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng, wrong = random.Random(given.seed), 0
    for name in given.only or COMMANDS:
        for _ in range(2):  # the first may have to compile
            with tempfile.TemporaryDirectory() as folder:
                code, output, whole_s = run(COMMANDS[name], 0, 600, Path(folder), group=False)
        if code:
            print(f"{name}: cannot run here ({output.strip()[-200:]})")
            continue
        # Only to the process, as kill does, and to its group, as a terminal and some batch systems do.
        for number, group in ((signal.SIGTERM, False), (signal.SIGTERM, True), (signal.SIGINT, True)):
            codes: Counter[int] = Counter()
            bad = 0
            for _ in range(given.instants):
                with tempfile.TemporaryDirectory() as folder:
                    after_s = rng.uniform(0, min(whole_s, given.within))
                    code, output, _ = run(COMMANDS[name], number, after_s, Path(folder), group=group)
                codes[code] += 1
                if any(word in output for word in BAD) or code not in {0, 128 + number, -number}:
                    bad += 1
                    print(f"--- after {after_s:.3f} s, exit code {code}:\n{output}")
            wrong += bad
            to = "group" if group else "process"
            print(
                f"{name}, {number.name} to the {to}: {given.instants} instants, {bad} bad, exit codes {dict(codes)}",
                flush=True,
            )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
