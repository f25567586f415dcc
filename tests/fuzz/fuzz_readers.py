"""Fuzz the readers: damaged surveys in, nothing out but points or one message.

``python tests/fuzz/fuzz_readers.py --minutes 60 --seed 1`` damages valid surveys and prints what became of them;
``--inputs 3000`` ends after so many. What the readers cannot deal with is made small and kept in ``seeds/``. The same
seed gives the same inputs, as far as it gets in the time.
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


def key_of(verdict):
    """What tells a fault from others."""
    return f"{verdict.kind}: {verdict.where}"


def keep(judge, start, edits, verdict):
    """Leave edits out as long as the fault stays, and write the input into the folder of seeds; return its name."""
    # In a new process: what earlier inputs left in memory may have had its part.
    judge.close()
    for index in reversed(range(len(edits))):
        fewer = edits[:index] + edits[index + 1 :]
        if key_of(judge.verdict(start.name, applied(start.data, fewer))) == key_of(verdict):
            edits = fewer
    data = applied(start.data, edits)
    stem, _, suffix = start.name.partition(".")
    name = f"{verdict.kind}-{stem}-{hashlib.sha256(data).hexdigest()[:8]}.{suffix}"
    (SEEDS / name).write_bytes(data)
    return name


def fuzz(judge, minutes, inputs, seed):
    """Judge so many inputs or minutes at most; return the verdicts by survey, and the seed of each fault."""
    surveys, counts, faults = starts(), Counter(), {}
    began, made = time.monotonic(), 0
    while time.monotonic() - began < 60 * minutes and made < inputs:
        rng = np.random.default_rng([seed, made])
        start = surveys[int(rng.integers(len(surveys)))]
        edits = mutated(start, surveys, rng)
        made += 1
        verdict = judge.verdict(start.name, applied(start.data, edits))
        counts[f"{start.name} {verdict.kind}"] += 1
        if verdict.is_fault and key_of(verdict) not in faults:
            faults[key_of(verdict)] = [keep(judge, start, edits, verdict), verdict.detail[-1500:]]
    return {"inputs": made, "verdicts": dict(sorted(counts.items())), "faults": faults}


def main():
    """Fuzz and print; exit code 1 where faults were found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--inputs", type=int, default=10**9, help="end after so many")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        judge = Judge(Path(scratch))
        try:
            found = fuzz(judge, given.minutes, given.inputs, given.seed)
        finally:
            judge.close()
    sys.stdout.write(json.dumps(found, indent=1) + "\n")
    return 1 if found["faults"] else 0


if __name__ == "__main__":
    sys.exit(main())
