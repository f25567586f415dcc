"""One input, one verdict, under limits of memory and time.

``trial.py FOLDER surveys|files`` writes "ready", then reads a JSON string a line, the path of an input, and writes a
verdict for each.
"""

import contextlib
import ctypes
import json
import logging
import os
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1] / "hostile"))

from corpus.runner import MEMORY, Lines
from driver import limit
from files import UnreadError, make_cases
from mutate import starts

import bumpymap.readers
from bumpymap.core.errors import BumpymapError
from bumpymap.readers import PointStats, open_survey

__all__ = ["Judge", "Verdict"]

_SECONDS = 15
"""Of processor time; of time four times as many, for what waits."""
_READERS = str(Path(bumpymap.readers.__file__).parent)
_HOUSE = str(Path(bumpymap.readers.__file__).parents[1])
_SMALL = 16


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of an input."""

    kind: str
    """``read``, ``refused``, or a fault: ``escaped``, ``memory``, ``short``, ``differs``, ``unnamed``, ``noise``,
    ``died``, ``hang``, ``fetched``, ``outside``."""
    where: str = ""
    """Of a fault: what tells it from others."""
    detail: str = ""
    lines: tuple[tuple[str, int], ...] = ()
    """Lines of the readers that no input before had reached, in the process that read it."""

    @property
    def is_fault(self) -> bool:
        """Whether the readers failed to deal with the input."""
        return self.kind not in {"read", "refused"}


class Judge:
    """Has inputs read by a process of its own; ``folder`` is its scratch, ``what`` is ``surveys`` or ``files``."""

    def __init__(self, folder: Path, what: str) -> None:
        self._folder = folder
        self._lines = Lines([Path(__file__), folder, what], 4.0 * _SECONDS, {}, folder / "said")
        self.close = self._lines.close

    def verdict(self, name: str, data: bytes) -> Verdict:
        """Judge an input; a process that dies is the verdict of the input that it died of."""
        path = self._folder / name.replace("/", "_")
        path.write_bytes(data)
        answer = self._lines.ask(str(path))
        path.unlink()
        if answer is not None:
            return Verdict(**answer | {"lines": tuple(map(tuple, answer["lines"]))})
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


def watched(cases: Mapping[str, Any], log: Path, opened: Callable[[], bool]) -> Callable[[Path], Verdict]:
    """Return a judge that runs the case an input is named after, and looks at what it fetched and wrote.

    Parameters
    ----------
    cases : mapping
        Name of an input -> its `Case`.
    log : Path
        Grows with each request of the network.
    opened : callable
        Returns whether a file that nobody may open was opened since the last call.
    """
    outside: list[str] = []
    home: list[str] = []

    def hear(event: str, details: tuple[Any, ...]) -> None:
        if event == "open" and home and isinstance(details[0], str | bytes | os.PathLike):
            path = os.fsdecode(details[0])
            path = os.path.realpath(path) if path.startswith("/") else home[0]  # others are relative to an open folder
            writes = bool((details[2] or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
            if writes and not path.startswith((home[0], "/dev/", "/proc/")) and "__pycache__" not in path:
                outside.append(path)

    def judge(path: Path) -> Verdict:
        if not home:
            sys.addaudithook(hear)
        before, place = log.stat().st_size, Path(tempfile.mkdtemp(dir=path.parent))
        home[:], outside[:] = [str(path.parent)], []
        case = cases[path.name]
        given = case.place(path.read_bytes(), place)
        listed = _listed(given)
        verdict = _outcome(lambda: case.run(place))
        changed = set() if case.writes else {name for name, *_ in listed ^ _listed(given)}
        shutil.rmtree(place)
        if log.stat().st_size != before:
            return Verdict("fetched", path.name, "a request of the network was made")
        strays = [*sorted(changed), *outside, *["the file that leads outside"] * opened()]
        return Verdict("outside", path.name, f"{strays[0]} was opened or changed") if strays else verdict

    return judge


def _outcome(run: Callable[[], None]) -> Verdict:
    try:
        run()
    except (BumpymapError, UnreadError) as error:
        return Verdict("refused", detail=str(error))
    except MemoryError:
        return Verdict("memory", _place(), traceback.format_exc())
    except BaseException as error:  # noqa: BLE001 (a Rust panic is no Exception)
        return Verdict("escaped", f"{type(error).__name__} {_place()}", traceback.format_exc())
    return Verdict("read")


def _listed(folder: Path) -> set[tuple[str, int, int]]:
    """Return the files in a folder: path, size and time of the last change, ns."""
    found = ((path, path.lstat()) for path in folder.rglob("*") if not path.is_dir())
    return {(str(path), status.st_size, status.st_mtime_ns) for path, status in found}


_IN_OPEN, _IN_NONBLOCK = 0x20, 0o4000


def openings(path: Path) -> Callable[[], bool]:
    """Return what tells whether any process has opened a file since it was last asked; on Linux, else never."""
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "inotify_init1"):
        return lambda: False
    watch = libc.inotify_init1(_IN_NONBLOCK)
    libc.inotify_add_watch(watch, os.fsencode(path), _IN_OPEN)

    def opened() -> bool:
        try:
            return bool(os.read(watch, 65_536))
        except BlockingIOError:
            return False

    return opened


def _in_pieces(reader) -> tuple[int, str]:
    """Points that count, read in small pieces back to front, and why the file was refused that way."""
    batches = {}
    try:
        for chunk in reversed(reader.chunks(_SMALL)):
            batches[chunk.index] = reader.convert(chunk, reader.fetch(chunk))
        stats = PointStats()
        for index in sorted(batches):
            stats = stats.merge(batches[index].stats)
        reader.verify(stats)
    except BumpymapError as error:
        return 0, str(error)
    return sum(batch.cloud.easting.size for batch in batches.values()), ""


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


@contextlib.contextmanager
def _traced(known):
    """Collect lines of the readers that are not known yet, and make them known."""
    fresh: set[tuple[str, int]] = set()

    def in_line(frame, event, arg):
        key = (frame.f_code.co_filename[len(_READERS) :], frame.f_lineno)
        if key not in known:
            known.add(key)
            fresh.add(key)
        return in_line

    def in_call(frame, event, arg):
        return in_line if frame.f_code.co_filename.startswith(_READERS) else None

    sys.settrace(in_call)
    try:
        yield fresh
    finally:
        sys.settrace(None)


def _serve(folder: Path, what: str) -> None:
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    said = os.open(folder / "said", os.O_RDWR)
    os.dup2(said, 1)
    os.dup2(said, 2)
    if what == "files":
        valid = Path(tempfile.mkdtemp(dir=folder))
        cases = {case.start.name.replace("/", "_"): case for case in make_cases(valid)}
        judge = watched(cases, folder / "traps" / "requests", openings(folder / "traps" / "secret.tif"))
    else:
        judge = read_whole
        for start in starts():  # compiles kernels and loads libraries
            path = folder / f"valid_{start.name}"
            path.write_bytes(start.data)
            if (verdict := read_whole(path)).kind != "read":
                raise RuntimeError(f"{start.name}, which is valid, is {verdict.kind}: {verdict.detail}")
            path.unlink()
    limit(MEMORY)
    # Notes of the readers are no noise; a warning that Python prints is, each time.
    logging.getLogger("bumpymap").addHandler(logging.NullHandler())
    for category in (RuntimeWarning, UserWarning):
        warnings.simplefilter("always", category)
    known: set[tuple[str, int]] = set()
    answers.write('"ready"\n')
    answers.flush()
    for line in sys.stdin:
        os.ftruncate(said, 0)
        os.lseek(said, 0, os.SEEK_SET)
        signal.setitimer(signal.ITIMER_PROF, _SECONDS)
        with _traced(known) if judge is read_whole else contextlib.nullcontext(set()) as fresh:
            verdict = judge(Path(json.loads(line)))
        signal.setitimer(signal.ITIMER_PROF, 0)
        noise = os.pread(said, 4000, 0).decode("utf-8", "replace")
        if noise and not verdict.is_fault and judge is read_whole:
            verdict = Verdict("noise", _gist(noise), noise)
        answers.write(json.dumps(asdict(verdict) | {"lines": sorted(fresh)}) + "\n")
        answers.flush()


if __name__ == "__main__":
    _serve(Path(sys.argv[1]), sys.argv[2])
