"""One input, one verdict, under limits of memory and time.

``trial.py FOLDER`` reads a JSON string a line, the path of an input, and writes a verdict for each.
"""

import logging
import signal
import sys
import traceback
import warnings
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "hostile"))

from corpus.runner import MEMORY, Lines
from driver import serve, text_said
from mutate import starts

import bumpymap
from bumpymap.core.errors import BumpymapError
from bumpymap.readers import PointStats, open_survey

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


class Judge:
    """Has inputs read by a process of its own; ``folder`` is its scratch."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lines = Lines([Path(__file__), folder], 4.0 * _SECONDS, {}, folder / "said")
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
        return Verdict(
            "differs", f"{path.name.split('.')[-1]} pieces", f"read as a whole, refused in pieces: {complaint}"
        )
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


def _warm(folder: Path) -> None:
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


def _answer(path: str) -> dict[str, str]:
    signal.setitimer(signal.ITIMER_PROF, _SECONDS)
    verdict = read_whole(Path(path))
    signal.setitimer(signal.ITIMER_PROF, 0)
    noise = text_said()[:4000]
    if noise and not verdict.is_fault:
        verdict = Verdict("noise", _gist(noise), noise)
    return asdict(verdict)


if __name__ == "__main__":
    serve(partial(_warm, Path(sys.argv[1])), _answer, MEMORY)
