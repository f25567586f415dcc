"""Run a command and say what it took: wall time, processor time, peak memory.

Linux counts the memory of the process that starts a command into the command's own peak, so nothing heavy may be
imported here or in ``run.py``.
"""

import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

__all__ = ["Sample", "run_timed", "warm"]

_MIB = 1 << 20
_EVERY = 0.05
"""Time between two looks at the memory of a command and its helpers, s."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One run of one command, with all that it started."""

    wall: float
    """s."""
    cpu: float
    """User and system, s."""
    peak: float
    """Largest memory of the command and its helpers together, what they share counted once, bytes."""
    alone: float
    """Largest resident memory of a single process, bytes; exact, where ``peak`` is sampled."""
    exit_code: int
    output: str
    """Its standard output."""
    complaint: str
    """End of its standard error."""

    def record(self) -> dict[str, Any]:
        """Return what is kept of it in the results."""
        kept: dict[str, Any] = {
            "wall_s": self.wall,
            "cpu_s": self.cpu,
            "peak_bytes": self.peak,
            "alone_bytes": self.alone,
        }
        return kept if self.exit_code == 0 else {**kept, "exit_code": self.exit_code, "complaint": self.complaint}


def run_timed(command: Sequence[str], env: Mapping[str, str] | None = None) -> Sample:
    """Run a whole command from start to end; ``env`` is added to the environment."""
    os.sync()  # what the command before has written must not be paid by this one
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        started = time.perf_counter()
        process = subprocess.Popen(
            command, stdout=out, stderr=err, stdin=subprocess.DEVNULL, env={**os.environ, **(env or {})}
        )
        with _Watch(process.pid) as watch:
            _, status, usage = os.wait4(process.pid, 0)
            wall = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        return Sample(
            wall=wall,
            cpu=usage.ru_utime + usage.ru_stime,
            peak=max(watch.peak, usage.ru_maxrss * 1024.0),
            alone=usage.ru_maxrss * 1024.0,
            exit_code=process.returncode,
            output=out.read().decode(errors="replace"),
            complaint=err.read().decode(errors="replace")[-800:],
        )


class _Watch:
    """Looks at a process and all below it again and again, and remembers the largest sum of their shares of memory.

    A share (PSS) divides pages that several processes map among them. The system walks all pages of a process for it,
    so it is asked only where the plain sizes, which are cheap and never smaller, could make a new record.
    """

    def __init__(self, pid: int) -> None:
        self.peak = 0.0
        self._pid = pid
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look_on, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _look_on(self) -> None:
        while not self._ended.wait(_EVERY):
            tree = list(_tree(self._pid))
            if sum(map(_resident, tree)) > self.peak:
                self.peak = max(self.peak, sum(map(_share, tree)))


def _tree(pid: int) -> Iterator[int]:
    """Give a process and all that it and its children started, as far as they live."""
    yield pid
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in _read(path).split():
            yield from _tree(int(child))


def _resident(pid: int) -> float:
    """Resident size of a process, bytes."""
    words = _read(Path(f"/proc/{pid}/statm")).split()
    return float(words[1]) * os.sysconf("SC_PAGE_SIZE") if words else 0.0


def _share(pid: int) -> float:
    """Share of a process in the memory that it maps (PSS), bytes."""
    for line in _read(Path(f"/proc/{pid}/smaps_rollup")).splitlines():
        if line.startswith("Pss:"):
            return float(line.split()[1]) * 1024.0
    return 0.0


def _read(path: Path) -> str:
    """Read a file of /proc; nothing where its process has ended."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


def warm(path: Path) -> None:
    """Read a file through, so that every side finds it in the system's memory."""
    buffer = bytearray(8 * _MIB)
    with path.open("rb", buffering=0) as stream:
        while stream.readinto(buffer):
            pass
