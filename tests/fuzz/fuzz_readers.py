"""Fuzz the readers: damaged surveys in, nothing out but points or one message.

``python tests/fuzz/fuzz_readers.py --minutes 60 --seed 1 --report journal.json`` damages valid surveys; ``--inputs
3000`` ends after so many. What the readers cannot deal with is made small and kept in ``seeds/``. ``--replay`` runs the
files in ``seeds/`` instead, and prints a verdict each as JSON.

The same seed gives the same inputs, as far as it gets in the time.
"""

import argparse
import hashlib
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from trial import Judge

from mutate import applied, mutated, starts  # isort: skip (trial finds the corpus)

SEEDS = Path(__file__).parent / "seeds"
_JOURNAL_EVERY = 30.0


class Fuzzer:
    """Inputs, verdicts, and the faults that were found."""

    def __init__(self, seed: int, seeds: Path, judge: Judge) -> None:
        self._seed, self._seeds, self._judge, self._starts = seed, seeds, judge, starts()
        self.made = 0
        """Inputs so far."""
        self._counts: Counter[str] = Counter()
        self._faults: dict[str, dict[str, object]] = {}

    def step(self):
        """Make an input, have it judged, and keep the first input of each fault."""
        rng = np.random.default_rng([self._seed, self.made])
        start = self._starts[int(rng.integers(len(self._starts)))]
        edits = mutated(start, self._starts, rng)
        self.made += 1
        verdict = self._judged(start, edits)
        self._counts[f"{start.name} {verdict.kind}"] += 1
        if not verdict.is_fault:
            return
        key = f"{verdict.kind}: {verdict.where}"
        if key in self._faults:
            self._faults[key]["times"] += 1
            return
        # In a new process: what earlier inputs left in memory may have had its part.
        self._judge.close()
        for index in reversed(range(len(edits))):
            fewer = edits[:index] + edits[index + 1 :]
            again = self._judged(start, fewer)
            if f"{again.kind}: {again.where}" == key:
                edits = fewer
        data = applied(start.data, edits)
        stem, _, suffix = start.name.partition(".")
        name = f"{verdict.kind}-{stem}-{hashlib.sha256(data).hexdigest()[:8]}.{suffix}"
        self._seeds.mkdir(exist_ok=True)
        (self._seeds / name).write_bytes(data)
        self._faults[key] = {"seed": name, "times": 1, "edits": len(edits), "detail": verdict.detail[-1500:]}

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
            "verdicts": dict(sorted(kinds.items())),
            "by_survey": dict(sorted(self._counts.items())),
            "faults": self._faults,
        }


def fuzz(minutes: float, inputs: int, seed: int, report: Path | None, seeds: Path) -> int:
    """Fuzz for so many minutes or inputs at most; 1 where faults were found."""
    with tempfile.TemporaryDirectory() as scratch:
        judge = Judge(Path(scratch))
        made = Fuzzer(seed, seeds, judge)
        began = written = time.monotonic()
        try:
            while time.monotonic() - began < 60 * minutes and made.made < inputs:
                made.step()
                if report and time.monotonic() - written > _JOURNAL_EVERY:
                    written = time.monotonic()
                    report.write_text(json.dumps(made.journal(written - began), indent=1) + "\n", encoding="utf-8")
        finally:
            judge.close()
        record = made.journal(time.monotonic() - began)
    text = json.dumps(record, indent=1)
    if report:
        report.write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")
    return 1 if record["faults"] else 0


def replay(seeds: Path) -> int:
    """Judge the files that were kept; print name to kind and place."""
    with tempfile.TemporaryDirectory() as scratch:
        judge = Judge(Path(scratch))
        files = sorted(path for path in seeds.iterdir() if not path.name.startswith("."))
        verdicts = {path.name: judge.verdict(path.name, path.read_bytes()) for path in files}
        judge.close()
    held = {name: [verdict.kind, verdict.where] for name, verdict in verdicts.items()}
    sys.stdout.write(json.dumps(held, indent=1) + "\n")
    return 1 if any(verdict.is_fault for verdict in verdicts.values()) else 0


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Fuzz the readers of bumpymap.")
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--inputs", type=int, default=10**9, help="end after so many")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--report", type=Path, help="journal to write, JSON")
    parser.add_argument("--seeds", type=Path, default=SEEDS, help="folder of what was found")
    parser.add_argument("--replay", action="store_true", help="judge what was found before")
    given = parser.parse_args()
    if given.replay:
        return replay(given.seeds)
    return fuzz(given.minutes, given.inputs, given.seed, given.report, given.seeds)


if __name__ == "__main__":
    sys.exit(main())
