"""Run a command and measure wall time, processor time and peak memory.

Linux includes the memory of the parent process in the peak of a new process, so nothing heavy may be imported here or
in ``run.py``.
"""

import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import psutil

_NOT_OF_A_USER = ("PYTHONDONTWRITEBYTECODE", "PYTHONUNBUFFERED")
"""Settings of Python that make it slower."""
_POLL_SECONDS = 0.05


@dataclass(frozen=True, slots=True)
class Sample:
    """Measurements of one run of one command, with its child processes."""

    wall: float
    """s."""
    cpu: float
    """Processor time, user and system, s."""
    peak: float
    """Peak memory of the command and its child processes, with shared memory counted once, bytes; sampled."""
    exit_code: int
    stderr_tail: str
    """End of its standard error."""


def run_timed(command: Sequence[str], env: Mapping[str, str] | None = None, *, memory: bool = False) -> Sample:
    """Run a command to its end, in the environment of a user; ``env`` is added to it.

    With ``memory`` its memory is sampled, child processes included, which slows it down: large processes most, as the
    kernel walks all their pages. Without, ``peak`` is that of the largest process.
    """
    os.sync()  # so that writes of an earlier command do not slow this one down
    own = {name: value for name, value in os.environ.items() if name not in _NOT_OF_A_USER} | dict(env or {})
    peak, ended = [0.0], threading.Event()
    with tempfile.TemporaryFile() as err:
        started = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=err, stdin=subprocess.DEVNULL, env=own)
        sampling = threading.Thread(target=_sample, args=(psutil.Process(process.pid), peak, ended), daemon=True)
        if memory:
            sampling.start()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # its figures remain until it is waited for
        wall = time.perf_counter() - started
        ended.set()
        if memory:
            sampling.join()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        err.seek(0)
        tail = err.read().decode(errors="replace")[-800:]
    cpu, largest = usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024.0
    return Sample(wall, cpu, max(peak[0], largest), process.returncode, tail)


def _sample(parent, peak, ended):
    """Keep the peak of the sum of PSS of a process and its descendants [bytes] in ``peak[0]`` until ``ended`` is set.

    PSS (proportional set size) divides shared pages among the processes that map them. Reading it is slow, as the
    kernel walks all pages, so it is read only if the sum of resident sizes, which is never smaller, exceeds the peak.
    """
    while not ended.wait(_POLL_SECONDS):
        with suppress(psutil.Error):  # one of them has ended
            tree = [parent, *parent.children(recursive=True)]
            if sum(process.memory_info().rss for process in tree) > peak[0]:
                peak[0] = max(peak[0], sum(process.memory_full_info().pss for process in tree))
