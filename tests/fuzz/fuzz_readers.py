"""Fuzz the readers: damaged surveys in, nothing out but points or one message.

``python tests/fuzz/fuzz_readers.py --minutes 60 --seed 1`` damages valid surveys and prints what became of them;
``--inputs 3000`` ends after so many. What the readers cannot deal with is made small and kept in ``seeds/``. The same
seed gives the same inputs, as far as it gets in the time. Each input has one verdict, of a process of its own under
limits of memory and time: with ``--judge FOLDER`` it reads a JSON string a line, the path of an input, and writes one.
"""

import argparse
import hashlib
import json
import logging
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "hostile"))

from corpus.runner import MEMORY, Lines
from driver import serve, text_said
from mutate import applied, mutated, starts

import bumpymap
from bumpymap.core.errors import BumpymapError
from bumpymap.readers import PointStats, open_survey

SEEDS = Path(__file__).parent / "seeds"
_SECONDS = 15
"""Of processor time; of time four times as many, for what waits."""
_HOUSE = str(Path(bumpymap.__file__).parent)
_SMALL = 16


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of an input."""

    kind: str
    """``read``, ``refused``, or a fault: ``escaped``, ``memory``, ``short``, ``differs``, ``unnamed``, ``noise``,
    ``died``, ``hang``."""
    where: str = ""
    """Of a fault: what tells it from others."""
    detail: str = ""

    @property
    def is_fault(self) -> bool:
        """Whether the readers failed to deal with the input."""
        return self.kind not in {"read", "refused"}

    @property
    def key(self) -> str:
        """What tells a fault from others."""
        return f"{self.kind}: {self.where}"


class Judge:
    """Has inputs read by a process of its own; ``folder`` is its scratch."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lines = Lines([Path(__file__), "--judge", folder], 4.0 * _SECONDS, {}, folder / "said")
        self.close = self._lines.close

    def verdict(self, name: str, data: bytes) -> Verdict:
        """Judge an input; a process that dies is the verdict of the input that it died of."""
        path = self._folder / name
        path.write_bytes(data)
        answer = self._lines.ask(str(path))
        path.unlink()
        if answer is not None:
            return Verdict(**answer)
        said = self._lines.said.read_text(encoding="utf-8", errors="replace")
        kind = "hang" if self._lines.ended.startswith(("no answer", "SIGPROF")) else "died"
        return Verdict(kind, f"{self._lines.ended} {_gist(said)}", said[-2000:])


def read_whole(path: Path) -> Verdict:
    """Read a survey front to back, then in small pieces back to front: both must say the same."""
    try:
        reader = open_survey(path)
        points = sum(cloud.easting.size for cloud in reader.clouds())
        seen = points + sum(reader.dropped.values())
        if seen != reader.info.point_count:
            return Verdict("short", "chunks", f"promised {reader.info.point_count}, saw {seen}")
        again, complaint = _in_pieces(reader)
    except BumpymapError as error:
        return Verdict("refused") if str(path) in str(error) else Verdict("unnamed", str(error)[:60], str(error))
    except MemoryError:
        return Verdict("memory", _place(), traceback.format_exc())
    except BaseException as error:  # noqa: BLE001 (a Rust panic is no Exception)
        return Verdict("escaped", f"{type(error).__name__} {_place()}", traceback.format_exc())
    if complaint:
        return Verdict("differs", f"{path.name.split('.')[-1]} pieces", f"read, and in pieces refused: {complaint}")
    return Verdict("read") if again == points else Verdict("short", "pieces", f"chunks give {points}, pieces {again}")


def _in_pieces(reader) -> tuple[int, str]:
    """Points that count, read in small pieces back to front, and why the file was refused that way."""
    stats, points = PointStats(), 0
    try:
        for chunk in reversed(reader.chunks(_SMALL)):
            batch = reader.convert(chunk, reader.fetch(chunk))
            stats, points = batch.stats.merge(stats), points + batch.cloud.easting.size
        reader.verify(stats)
    except BumpymapError as error:
        return 0, str(error)
    return points, ""


def _place() -> str:
    """Innermost line of bumpymap that the exception came through."""
    frames = traceback.extract_tb(sys.exc_info()[2])
    own = [frame for frame in frames if frame.filename.startswith(_HOUSE)] or list(frames)
    return f"{Path(own[-1].filename).name} {own[-1].name}"


def _gist(said: str) -> str:
    """Tell a panic by where in the decoder it was raised; other noise by its first line."""
    line = next((line for line in said.splitlines() if "panicked at" in line), said.strip().partition("\n")[0])
    panic = line.partition("panicked at ")[2].rpartition("/src/")[2]
    return panic or line.rpartition("/")[2][:80]


def warm(folder: Path) -> None:
    """Read what is valid, which compiles kernels and loads libraries."""
    for start in starts():
        path = folder / f"valid_{start.name}"
        path.write_bytes(start.data)
        if (verdict := read_whole(path)).kind != "read":
            raise RuntimeError(f"{start.name}, which is valid, is {verdict.kind}: {verdict.detail}")
        path.unlink()
    # Notes of the readers are no noise; a warning that Python prints is, each time.
    logging.getLogger("bumpymap").addHandler(logging.NullHandler())
    for category in (RuntimeWarning, UserWarning):
        warnings.simplefilter("always", category)


def answer(path: str) -> dict[str, str]:
    """Judge the input at a path, in this process."""
    signal.setitimer(signal.ITIMER_PROF, _SECONDS)
    verdict = read_whole(Path(path))
    signal.setitimer(signal.ITIMER_PROF, 0)
    noise = text_said()[:4000]
    if noise and not verdict.is_fault:
        verdict = Verdict("noise", _gist(noise), noise)
    return asdict(verdict)


def keep(judge, start, edits, verdict):
    """Leave edits out as long as the fault stays, and write the input into the folder of seeds; return its name."""
    # In a new process: what earlier inputs left in memory may have had its part.
    judge.close()
    for index in reversed(range(len(edits))):
        fewer = edits[:index] + edits[index + 1 :]
        if judge.verdict(start.name, applied(start.data, fewer)).key == verdict.key:
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
        if verdict.is_fault and verdict.key not in faults:
            faults[verdict.key] = [keep(judge, start, edits, verdict), verdict.detail[-1500:]]
    return {"inputs": made, "verdicts": dict(sorted(counts.items())), "faults": faults}


def main():
    """Fuzz and print; exit code 1 where faults were found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--inputs", type=int, default=10**9, help="end after so many")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--judge", type=Path, metavar="FOLDER", help="judge inputs instead; FOLDER is scratch")
    given = parser.parse_args()
    if given.judge:
        serve(lambda: warm(given.judge), answer, MEMORY)
        return 0
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
