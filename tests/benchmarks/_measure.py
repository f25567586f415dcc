"""Run a command and measure wall time, CPU time and peak memory.

Linux includes the memory of the parent process in the peak of a new process, so nothing heavy may be imported here or
in ``run.py``.
"""

import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

__all__ = ["Sample", "files_of", "run_timed", "user_environment", "warm_page_cache"]

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
    children: float
    """The part of it in child processes, s."""
    bytes_read: int
    """Bytes that read calls returned, of all files, in all processes."""
    bytes_written: int
    """Bytes given to write calls."""
    minor_faults: int
    """Pages that were entered into the table of a process without reading a disk."""
    major_faults: int
    """Pages that had to be read from a disk."""
    peak: float
    """Peak memory of the command and its child processes, with shared memory counted once, bytes; sampled."""
    largest_process: float
    """Peak resident memory of a single process, bytes; exact."""
    exit_code: int
    output: str
    """Its standard output."""
    stderr_tail: str
    """End of its standard error."""

    @property
    def cpu(self) -> float:
        """User and system time, s."""
        return self.user + self.system

    def record(self) -> dict[str, Any]:
        """Return the entry for the results file."""
        kept: dict[str, Any] = {
            "wall_s": self.wall,
            "cpu_s": self.cpu,
            "user_s": self.user,
            "system_s": self.system,
            "children_s": self.children,
            "bytes_read": self.bytes_read,
            "bytes_written": self.bytes_written,
            "minor_faults": self.minor_faults,
            "major_faults": self.major_faults,
            "peak_bytes": self.peak,
            "alone_bytes": self.largest_process,
        }
        return kept if self.exit_code == 0 else {**kept, "exit_code": self.exit_code, "complaint": self.stderr_tail}


def run_timed(command: Sequence[str], env: Mapping[str, str] | None = None, *, memory: bool = False) -> Sample:
    """Run a command to its end, in the environment of a user; ``env`` is added to it.

    With ``memory`` its memory is sampled, child processes included, which slows it down: large processes most, as the
    kernel walks all their pages. Without, ``peak`` is that of the largest process.
    """
    os.sync()  # so that writes of an earlier command do not slow this one down
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        started = time.perf_counter()
        process = subprocess.Popen(
            command, stdout=out, stderr=err, stdin=subprocess.DEVNULL, env={**user_environment(), **(env or {})}
        )
        with _MemoryMonitor(process.pid) if memory else nullcontext() as monitor:
            os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # its figures remain until it is waited for
            wall = time.perf_counter() - started
            children = _children_cpu(process.pid)
            # Only root may see what a process that has ended read and wrote. This process may see its own counts, to
            # which those are added when it waits for the other; so is every look at them.
            looks = [_own_bytes(), _own_bytes()]
            _, status, usage = os.wait4(process.pid, 0)
            looks.append(_own_bytes())
            read, written = (first - 2 * second + third for first, second, third in zip(*looks, strict=True))
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        return Sample(
            wall=wall,
            user=usage.ru_utime,
            system=usage.ru_stime,
            children=children,
            bytes_read=read,
            bytes_written=written,
            minor_faults=usage.ru_minflt,
            major_faults=usage.ru_majflt,
            peak=max(monitor.peak if monitor else 0.0, usage.ru_maxrss * 1024.0),
            largest_process=usage.ru_maxrss * 1024.0,
            exit_code=process.returncode,
            output=out.read().decode(errors="replace"),
            stderr_tail=err.read().decode(errors="replace")[-800:],
        )


def user_environment() -> dict[str, str]:
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


def _children_cpu(pid: int) -> float:
    """Return user and system time of the child processes that a process has waited for, s."""
    words = _read(Path(f"/proc/{pid}/stat")).rpartition(")")[2].split()
    return (int(words[13]) + int(words[14])) / os.sysconf("SC_CLK_TCK") if words else 0.0


def _own_bytes() -> tuple[int, int]:
    """Return the bytes that this process and the child processes it has waited for have read and written."""
    counts = dict(line.split(": ") for line in _read(Path("/proc/self/io")).splitlines())
    return int(counts["rchar"]), int(counts["wchar"])


def _read(path: Path) -> str:
    """Read a file of /proc; return an empty string if the process has ended."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


def files_of(survey: Path) -> list[Path]:
    """Return the files of a survey: the file itself, or those in a folder."""
    return sorted(survey.iterdir()) if survey.is_dir() else [survey]


def warm_page_cache(survey: Path) -> None:
    """Read all of a survey, so that all programs find it in the page cache."""
    buffer = bytearray(8 * _MIB)
    for path in files_of(survey):
        with path.open("rb", buffering=0) as stream:
            while stream.readinto(buffer):
                pass
