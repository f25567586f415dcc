"""Run a command and say what it took: wall time, processor time, peak memory.

Linux counts the memory of the process that starts a command into the command's own peak, so nothing heavy may be
imported here or in ``run.py``.
"""

import os
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Sample", "run_timed", "warm"]

_MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Sample:
    """One run of one command, with all that it started."""

    wall: float
    """s."""
    cpu: float
    """User and system, s."""
    peak: float
    """Largest resident memory of one process, bytes."""
    exit_code: int
    output: str
    """Its standard output."""
    complaint: str
    """End of its standard error."""

    def record(self) -> dict[str, Any]:
        """Return what is kept of it in the results."""
        kept: dict[str, Any] = {"wall_s": self.wall, "cpu_s": self.cpu, "peak_bytes": self.peak}
        return kept if self.exit_code == 0 else {**kept, "exit_code": self.exit_code, "complaint": self.complaint}


def run_timed(command: Sequence[str], env: Mapping[str, str] | None = None) -> Sample:
    """Run a whole command from start to end; ``env`` is added to the environment."""
    os.sync()  # what the command before has written must not be paid by this one
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        started = time.perf_counter()
        process = subprocess.Popen(
            command, stdout=out, stderr=err, stdin=subprocess.DEVNULL, env={**os.environ, **(env or {})}
        )
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        return Sample(
            wall=wall,
            cpu=usage.ru_utime + usage.ru_stime,
            peak=usage.ru_maxrss * 1024.0,
            exit_code=process.returncode,
            output=out.read().decode(errors="replace"),
            complaint=err.read().decode(errors="replace")[-800:],
        )


def warm(path: Path) -> None:
    """Read a file through, so that every side finds it in the system's memory."""
    buffer = bytearray(8 * _MIB)
    with path.open("rb", buffering=0) as stream:
        while stream.readinto(buffer):
            pass
