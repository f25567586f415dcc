"""Fuzz the readers: damaged surveys in, nothing out but points or one message.

``python tests/fuzz/fuzz_readers.py --minutes 60 --seed 1 --report journal.json`` damages valid surveys; those that
reach new lines of the readers are damaged further. ``--what files`` damages all other files and the folders of layers,
and looks at what is fetched, and written outside of the folder; ``--inputs 3000`` ends after so many. What the readers
cannot deal with is made small and kept in ``seeds/``; ``--keep`` keeps what reached new lines too. ``--replay`` runs
the files in ``seeds/`` instead, and prints a verdict each as JSON.

The same seed gives the same inputs, as far as it gets in the time.
"""

import argparse
import hashlib
import json
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from trial import Judge

from files import make_cases, plant_traps  # isort: skip (trial finds the corpus)
from mutate import Start, applied, mutated, starts  # isort: skip

SEEDS = Path(__file__).parent / "seeds"
_JOURNAL_EVERY = 30.0
_SMALL_FILE = 4096


class Fuzzer:
    """Inputs, verdicts, and what was learnt from them."""

    def __init__(
        self, seed: int, seeds: Path, judge: Judge, bases: Sequence[Start], traps: Sequence[bytes] = ()
    ) -> None:
        self._seed, self._seeds, self._judge, self._traps = seed, seeds, judge, traps
        self._bases, self._pool = list(bases), list(bases)
        self._lines: set[tuple[str, int]] = set()
        self.made = 0
        """Inputs so far."""
        self._counts: Counter[str] = Counter()
        self._faults: dict[str, dict[str, object]] = {}
        self._unconfirmed: Counter[str] = Counter()

    def step(self):
        """Make an input, have it judged, learn."""
        start = self._input(self.made)
        self.made += 1
        verdict = self._judged(start, start.edits)
        self._counts[f"{start.name} {verdict.kind}"] += 1
        if new := set(verdict.lines) - self._lines:
            self._lines |= new
            self._pool.append(start)
        if verdict.is_fault:
            self._keep(start, verdict)

    def _input(self, index):
        rng = np.random.default_rng([self._seed, index])
        pool = self._bases if rng.random() < 0.5 else self._pool
        start = pool[int(rng.integers(len(pool)))]
        if self._traps and rng.random() < 0.1:
            trap = self._traps[int(rng.integers(len(self._traps)))]
            return Start(start.name, start.data, start.fields, start.text_end, ((0, len(start.data), trap),))
        edits = mutated(start, self._bases, rng)
        return Start(start.name, start.data, start.fields, start.text_end, edits)

    def _keep(self, start, verdict):
        """Write the first input of each fault down, as small as it gets."""
        key = f"{verdict.kind}: {verdict.where}"
        if key in self._faults:
            self._faults[key]["times"] += 1
            return
        # In a new process: what earlier inputs left in memory may have had its part.
        self._judge.close()
        alone = self._judged(start, start.edits)
        if f"{alone.kind}: {alone.where}" != key:
            self._unconfirmed[f"{key} (alone: {alone.kind})"] += 1
            return
        edits = self._smaller(start, key)
        data = applied(start.data, edits)
        name = self._write(verdict.kind, start.name, data)
        self._faults[key] = {"seed": name, "times": 1, "edits": len(edits), "detail": verdict.detail[-1500:]}

    def _write(self, kind, survey, data):
        stem, _, suffix = survey.replace("/", "_").replace(" ", "_").replace(":", "_").partition(".")
        name = f"{kind}-{stem}-{hashlib.sha256(data).hexdigest()[:8]}.{suffix}"
        self._seeds.mkdir(exist_ok=True)
        (self._seeds / name).write_bytes(data)
        return name

    def keep_pool(self):
        """Write down what reached new lines, where it is small."""
        for start in self._pool[len(self._bases) :]:
            data = applied(start.data, start.edits)
            if len(data) <= _SMALL_FILE:
                self._write("reach", start.name, data)

    def _smaller(self, start, key):
        """Leave edits out while the fault stays the same."""
        edits = list(start.edits)
        for index in reversed(range(len(edits))):
            fewer = edits[:index] + edits[index + 1 :]
            verdict = self._judged(start, fewer)
            if f"{verdict.kind}: {verdict.where}" == key:
                edits = fewer
        return edits

    def _judged(self, start, edits):
        return self._judge.verdict(start.name, applied(start.data, edits))

    def journal(self, seconds):
        """Give what was done so far, as a record."""
        kinds: Counter[str] = Counter()
        for name, count in self._counts.items():
            kinds[name.split()[-1]] += count
        return {
            "seed": self._seed,
            "seconds": round(seconds, 1),
            "inputs": self.made,
            "inputs_per_second": round(self.made / max(seconds, 1e-9), 1),
            "lines_reached": len(self._lines),
            "pool": len(self._pool),
            "verdicts": dict(sorted(kinds.items())),
            "by_survey": dict(sorted(self._counts.items())),
            "faults": self._faults,
            "not_seen_again_alone": dict(self._unconfirmed),
        }


@contextmanager
def server(folder: Path) -> Iterator[tuple[str, Path]]:
    """Serve nothing on this machine; yield the URL and the log, which has a line for each request."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    log = folder / "requests"
    command = [sys.executable, "-m", "http.server", str(port), "--bind", "127.0.0.1", "--directory", str(folder)]
    with log.open("wb") as lines:
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=lines)
        try:
            yield f"http://127.0.0.1:{port}", log
        finally:
            run.terminate()
            run.wait()


@contextmanager
def fuzzer(what: str, seed: int, seeds: Path) -> Iterator[Fuzzer]:
    """Yield a fuzzer of surveys, or of all other files."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name in ("valid", "traps"):
            (folder / name).mkdir()
        judge = Judge(folder, what)
        try:
            if what == "surveys":
                yield Fuzzer(seed, seeds, judge, starts())
                return
            with server(folder / "traps") as (url, _):
                bases = [case.start for case in make_cases(folder / "valid")]
                traps = plant_traps(folder / "traps", url)
                for start in bases:
                    if (found := judge.verdict(start.name, start.data)).kind != "read":
                        raise RuntimeError(
                            f"{start.name}, which is valid, is {found.kind}: {found.where} {found.detail}"
                        )
                yield Fuzzer(seed, seeds, judge, bases, traps)
        finally:
            judge.close()


def fuzz(what: str, most: tuple[float, int], seed: int, report: Path | None, seeds: Path, *, keep: bool) -> int:
    """Fuzz for so many minutes or inputs at most; 1 where faults were found."""
    minutes, inputs = most
    with fuzzer(what, seed, seeds) as made:
        began = written = time.monotonic()
        while time.monotonic() - began < 60 * minutes and made.made < inputs:
            made.step()
            if report and time.monotonic() - written > _JOURNAL_EVERY:
                written = time.monotonic()
                report.write_text(json.dumps(made.journal(written - began), indent=1) + "\n", encoding="utf-8")
        record = made.journal(time.monotonic() - began)
        if keep:
            made.keep_pool()
    text = json.dumps(record, indent=1)
    if report:
        report.write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")
    return 1 if record["faults"] else 0


def replay(seeds: Path) -> int:
    """Judge the files that were kept; print name to kind and place."""
    with tempfile.TemporaryDirectory() as scratch:
        judge = Judge(Path(scratch), "surveys")
        files = sorted(path for path in seeds.iterdir() if not path.name.startswith("."))
        verdicts = {path.name: judge.verdict(path.name, path.read_bytes()) for path in files}
        judge.close()
    held = {name: [verdict.kind, verdict.where] for name, verdict in verdicts.items()}
    sys.stdout.write(json.dumps(held, indent=1) + "\n")
    return 1 if any(verdict.is_fault for verdict in verdicts.values()) else 0


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Fuzz the readers of bumpymap.")
    parser.add_argument("--what", choices=("surveys", "files"), default="surveys")
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--inputs", type=int, default=10**9, help="end after so many")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--report", type=Path, help="journal to write, JSON")
    parser.add_argument("--seeds", type=Path, default=SEEDS, help="folder of what was found")
    parser.add_argument("--keep", action="store_true", help="keep what reached new lines of the readers")
    parser.add_argument("--replay", action="store_true", help="judge what was found before")
    given = parser.parse_args()
    if given.replay:
        return replay(given.seeds)
    return fuzz(given.what, (given.minutes, given.inputs), given.seed, given.report, given.seeds, keep=given.keep)


if __name__ == "__main__":
    sys.exit(main())
