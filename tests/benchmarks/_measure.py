"""Run a command and measure wall time, CPU time and peak memory.

Linux includes the memory of the parent process in the peak of a new process, so nothing heavy may be imported here or
in ``run.py``.
"""

import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

__all__ = ["Sample", "run_timed", "table", "warm_page_cache"]

_MIB = 1 << 20
_NOT_OF_A_USER = ("PYTHONDONTWRITEBYTECODE", "PYTHONUNBUFFERED")
_POLL_SECONDS = 0.05
"""Interval between two samples of the memory of a command and its child processes, s."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Measurements of one run of one command, with its child processes."""

    wall: float
    """s."""
    user: float
    """Processor time in programs and libraries, s."""
    system: float
    """Processor time in the kernel of the operating system, s."""
    peak: float
    """Peak memory of the command and its child processes, with shared memory counted once, bytes; sampled."""
    exit_code: int
    output: str
    """Its standard output."""
    stderr_tail: str
    """End of its standard error."""

    @property
    def cpu(self) -> float:
        """User and system time, s."""
        return self.user + self.system


def run_timed(command: Sequence[str], env: Mapping[str, str] | None = None, *, memory: bool = False) -> Sample:
    """Run a command to its end, in the environment of a user; ``env`` is added to it.

    With ``memory`` its memory is sampled, child processes included, which slows it down: large processes most, as the
    kernel walks all their pages. Without, ``peak`` is that of the largest process.
    """
    os.sync()  # so that writes of an earlier command do not slow this one down
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        started = time.perf_counter()
        process = subprocess.Popen(
            command, stdout=out, stderr=err, stdin=subprocess.DEVNULL, env={**_user_environment(), **(env or {})}
        )
        with _MemoryMonitor(process.pid) if memory else nullcontext() as monitor:
            os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # its figures remain until it is waited for
            wall = time.perf_counter() - started
            _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        return Sample(
            wall=wall,
            user=usage.ru_utime,
            system=usage.ru_stime,
            peak=max(monitor.peak if monitor else 0.0, usage.ru_maxrss * 1024.0),
            exit_code=process.returncode,
            output=out.read().decode(errors="replace"),
            stderr_tail=err.read().decode(errors="replace")[-800:],
        )


def _user_environment() -> dict[str, str]:
    """Return the environment without settings of Python that a user does not have and that make it slower."""
    return {name: value for name, value in os.environ.items() if name not in _NOT_OF_A_USER}


class _MemoryMonitor:
    """Poll the memory of a process and its descendants and keep the peak of the sum of their PSS.

    PSS (proportional set size) divides shared pages among the processes that map them. Reading it is slow, as the
    kernel walks all pages, so it is read only if the sum of resident sizes, which is never smaller, exceeds the peak.
    """

    def __init__(self, pid: int) -> None:
        self.peak = 0.0
        self._pid = pid
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._poll, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _poll(self) -> None:
        while not self._ended.wait(_POLL_SECONDS):
            tree = list(_tree(self._pid))
            if sum(map(_resident, tree)) > self.peak:
                self.peak = max(self.peak, sum(map(_share, tree)))


def _tree(pid: int) -> Iterator[int]:
    """Yield a process and all its living descendants."""
    yield pid
    with suppress(OSError):  # it has ended
        for thread in Path(f"/proc/{pid}/task").iterdir():
            for child in _read(thread / "children").split():
                yield from _tree(int(child))


def _resident(pid: int) -> float:
    """Return the resident size of a process, bytes."""
    words = _read(Path(f"/proc/{pid}/statm")).split()
    return float(words[1]) * os.sysconf("SC_PAGE_SIZE") if words else 0.0


def _share(pid: int) -> float:
    """Return the proportional set size (PSS) of a process, bytes."""
    for line in _read(Path(f"/proc/{pid}/smaps_rollup")).splitlines():
        if line.startswith("Pss:"):
            return float(line.split()[1]) * 1024.0
    return 0.0


def _read(path: Path) -> str:
    """Read a file of /proc; return an empty string if the process has ended."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


def warm_page_cache(survey: Path) -> None:
    """Read all of a survey, so that all programs find it in the page cache."""
    buffer = bytearray(8 * _MIB)
    for path in sorted(survey.iterdir()) if survey.is_dir() else [survey]:
        with path.open("rb", buffering=0) as stream:
            while stream.readinto(buffer):
                pass


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table as Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
