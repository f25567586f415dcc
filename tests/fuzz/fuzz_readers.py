"""Fuzz the readers: damaged surveys in, nothing out but points or one message.

``python tests/fuzz/fuzz_readers.py --minutes 60 --seed 1`` damages valid surveys and prints what became of them;
``--inputs 3000`` ends after so many. What the readers cannot deal with is kept in ``seeds/``. The same seed gives the
same inputs, as far as it gets in the time. Each input has one verdict, of a process of its own under limits of memory
and time.
"""

import argparse
import hashlib
import json
import logging
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import astuple, dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "hostile"))

from corpus.files import bases, number_fields
from corpus.runner import Child, text_said

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
        self._child = Child(partial(warm, folder), answer, 4.0 * _SECONDS, folder / "said")
        self.close = self._child.close

    def verdict(self, name: str, data: bytes) -> Verdict:
        """Judge an input; a process that dies is the verdict of the input that it died of."""
        path = self._folder / name
        path.write_bytes(data)
        found = self._child.ask(path)
        path.unlink()
        if found is not None:
            return Verdict(*found)
        said = self._child.said.read_text(encoding="utf-8", errors="replace")
        kind = "hang" if self._child.ended.startswith(("no answer", "SIGPROF")) else "died"
        return Verdict(kind, f"{self._child.ended} {_gist(said)}", said[-2000:])


def read_whole(path: Path) -> Verdict:
    """Read a survey front to back, then in small pieces back to front: both must say the same."""
    points = -1
    try:
        reader = open_survey(path)
        points = sum(cloud.easting.size for cloud in reader.clouds())
        seen = points + sum(reader.dropped.values())
        if seen != reader.info.point_count:
            return Verdict("short", "chunks", f"promised {reader.info.point_count}, saw {seen}")
        stats, again = PointStats(), 0
        for chunk in reversed(reader.chunks(_SMALL)):
            batch = reader.convert(chunk, reader.fetch(chunk))
            stats, again = batch.stats.merge(stats), again + batch.cloud.easting.size
        reader.verify(stats)
    except BumpymapError as error:
        if points >= 0:
            return Verdict("differs", f"{path.name.split('.')[-1]} pieces", f"read, and in pieces refused: {error}")
        return Verdict("refused") if str(path) in str(error) else Verdict("unnamed", str(error)[:60], str(error))
    except MemoryError:
        return Verdict("memory", _place(), traceback.format_exc())
    except BaseException as error:  # noqa: BLE001 (a Rust panic is no Exception)
        return Verdict("escaped", f"{type(error).__name__} {_place()}", traceback.format_exc())
    return Verdict("read") if again == points else Verdict("short", "pieces", f"chunks give {points}, pieces {again}")


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
    """Read what is valid, which loads libraries."""
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


def answer(path: Path) -> tuple[str, str, str]:
    """Judge the input at a path, in this process."""
    signal.setitimer(signal.ITIMER_PROF, _SECONDS)
    verdict = read_whole(path)
    signal.setitimer(signal.ITIMER_PROF, 0)
    noise = text_said()[:4000]
    if noise and not verdict.is_fault:
        verdict = Verdict("noise", _gist(noise), noise)
    return astuple(verdict)


# ---- damage: some edits of a valid survey, each a start, an end and the bytes that stand there instead ----

_INTEGERS = (0, 1, 2, 7, 100, *(2**bits - below for bits in (15, 16, 31, 32, 40, 62, 63, 64) for below in (1, 0)))
_REALS = (0.0, -0.0, 1.0, -1.0, float("nan"), float("inf"), -float("inf"), 1e300, -1e300, 1e-300, 4e9, -4e9, 1e16)


class Start(NamedTuple):
    """A valid survey to damage."""

    name: str
    data: bytes
    fields: tuple[tuple[int, str], ...]
    """Place and layout (little endian) of the numbers that its structure is made of."""


def starts():
    """Give every valid survey, of 40 points each."""
    for name, data in bases(40).items():
        fields = tuple(number_fields(data)) if name.endswith((".las", ".laz")) else ()
        if name == "packed.pcd":
            packed = data.index(b"\n", data.index(b"DATA")) + 1
            fields = (packed, "I"), (packed + 4, "I")
        yield Start(name, data, fields)


def mutated(start: Start, others: list[Start], rng: np.random.Generator) -> bytes:
    """Make one to four edits, each of what the edits before it left."""
    data = start.data
    for _ in range(int(rng.integers(1, 5))):
        of_field = start.fields and rng.random() < 0.55
        first, end, new = _field_edit(data, start, rng) if of_field else _block_edit(data, others, rng)
        data = data[:first] + new + data[end:]
    return data


def _field_edit(data, start, rng):
    place, layout = _chosen(start.fields, rng)
    size = struct.calcsize("<" + layout)
    if layout == "d":
        return place, place + size, struct.pack("<d", _chosen(_REALS, rng))
    own = int.from_bytes(data[place : place + size], "little")
    near = (own + 1, own - 1, own * 2, own // 2, len(data), len(data) - 8, own ^ (1 << int(rng.integers(8 * size))))
    value = _chosen(_INTEGERS if rng.random() < 0.5 else near, rng) % 256**size
    return place, place + size, value.to_bytes(size, "little")


def _block_edit(data, others, rng):
    """Change a byte; cut the end off; remove, double, blank or exchange a block; take one from another survey."""
    place, size = int(rng.integers(max(len(data), 1))), int(2 ** rng.uniform(0, 9))
    own, other = (each[int(rng.integers(max(len(each), 1))) :][:size] for each in (data, _chosen(others, rng).data))
    end, byte = place + size, data[place] if data else 0
    return _chosen(
        (
            (place, place + 1, bytes([int(rng.integers(256))])),
            (place, place + 1, bytes([byte ^ (1 << int(rng.integers(8)))])),
            (place, len(data), b""),
            (place, end, b""),
            (place, place, data[place:end]),
            (place, end, b"\0" * size),
            (place, end, b"\xff" * size),
            (place, end, own),
            (place, end, other),
        ),
        rng,
    )


def _chosen(choices, rng):
    return choices[int(rng.integers(len(choices)))]


# ---- fuzzing ----


def fuzz(judge, minutes, inputs, seed):
    """Judge so many inputs or minutes at most; return the verdicts by survey, and the seed of each fault."""
    surveys, counts, faults = [*starts()], Counter(), {}
    began, made = time.monotonic(), 0
    while time.monotonic() - began < 60 * minutes and made < inputs:
        rng = np.random.default_rng([seed, made])
        start = surveys[int(rng.integers(len(surveys)))]
        data = mutated(start, surveys, rng)
        made += 1
        verdict = judge.verdict(start.name, data)
        counts[f"{start.name} {verdict.kind}"] += 1
        if verdict.is_fault and verdict.key not in faults:
            stem, _, suffix = start.name.partition(".")
            name = f"{verdict.kind}-{stem}-{hashlib.sha256(data).hexdigest()[:8]}.{suffix}"
            (SEEDS / name).write_bytes(data)
            faults[verdict.key] = [name, verdict.detail[-1500:]]
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
