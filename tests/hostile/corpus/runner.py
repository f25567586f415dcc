"""Parent of ``driver.py``: gives it one command at a time, kills it when it hangs, starts it again when it died."""

import json
import os
import select
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from .bases import bases

__all__ = ["MEMORY", "SECONDS", "Outcome", "Runner"]

SECONDS = 10.0
MEMORY = 1_500_000_000
_DRIVER = Path(__file__).parents[1] / "driver.py"
_STARTING = 300.0
"""Seconds for the first run of all, which may compile kernels."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one command."""

    exit: int | str
    """Exit code; a traceback where an exception came out, or how the process ended."""
    text: str
    """Everything on standard output and standard error."""
    peak: int
    """Most memory resident, bytes."""
    threads: tuple[str, ...]
    """Python threads that were left running."""

    @property
    def errors(self):
        """Lines that begin an error message."""
        return [line for line in self.text.splitlines() if line.startswith("Error: ")]


class Runner:
    """Runs commands of bumpymap in a child process; ``folder`` is its own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.scratch = folder / "scratch"
        self.scratch.mkdir()
        self._good = folder / "good.las"
        self._good.write_bytes(bases()["las12.las"])
        self._child: subprocess.Popen[str] | None = None

    def run(self, *argv):
        """Outcome of one command."""
        if self._child is None:
            self._start()
        return self._ask(json.dumps([str(word) for word in argv]), SECONDS)

    def close(self):
        """End the child."""
        if self._child is not None:
            self._child.kill()
            self._child.wait()
            self._child.stdin.close()
            self._child.stdout.close()
            self._child = None

    def _start(self):
        # One thread each: the pools of libraries would reserve memory for as many as the machine has cores.
        pools = dict.fromkeys(("RAYON_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MALLOC_ARENA_MAX"), "1")
        out = self._folder / "good_out"
        shutil.rmtree(out, ignore_errors=True)
        self._child = subprocess.Popen(
            [sys.executable, str(_DRIVER), str(self._good), str(out), str(MEMORY)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            env=os.environ | pools | {"TMPDIR": str(self.scratch), "COLUMNS": "200"},
        )
        started = self._answer(_STARTING)
        if started.exit != 0:
            raise RuntimeError(f"a valid survey cannot be mapped: {started.exit}\n{started.text}")

    def _ask(self, line, seconds):
        try:
            self._child.stdin.write(line + "\n")
            self._child.stdin.flush()
        except BrokenPipeError:
            pass
        return self._answer(seconds)

    def _answer(self, seconds):
        ready, _, _ = select.select([self._child.stdout], [], [], seconds)
        line = self._child.stdout.readline() if ready else ""
        if line:
            said = json.loads(line)
            return Outcome(said["exit"], said["text"], said["peak"], tuple(said["threads"]))
        child = self._child
        self.close()
        ended = f"the process ended with {child.returncode}" if ready else f"no answer within {seconds:g} s"
        return Outcome(ended, "", 0, ())
