"""A process that answers each line with one; it is killed when it hangs, and started again when it died."""

import json
import os
import select
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from .files import bases

SECONDS = 10.0
MEMORY = 1_500_000_000
_DRIVER = Path(__file__).parents[1] / "driver.py"
_STARTING = 300.0
"""Seconds for the first run of all, which loads libraries."""


class Lines:
    """Asks a process of Python, which says when it is ready, by lines of JSON.

    ``seconds``: for each answer; ``said``: where its standard error goes.
    """

    def __init__(self, command: list, seconds: float, environment: dict, said: Path) -> None:
        self._command, self._seconds, self._environment, self.said = command, seconds, environment, said
        self._child: subprocess.Popen[str] | None = None
        self.ended = ""
        """How the process ended, after an answer that did not come."""

    def ask(self, question):
        """Give the answer; None where the process died or hung."""
        if self._child is None:
            self._start()
        try:
            self._child.stdin.write(json.dumps(question) + "\n")
            self._child.stdin.flush()
        except BrokenPipeError:
            pass
        return self._answer(self._seconds)

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
        with self.said.open("w+b") as said:  # the child reads it too
            self._child = subprocess.Popen(
                [sys.executable, *map(str, self._command)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=said,
                text=True,
                encoding="utf-8",
                env=os.environ | pools | self._environment,
            )
        if self._answer(_STARTING) != "ready":
            raise RuntimeError(f"{self._command} does not start: {self.ended}\n{self.said.read_text()[-4000:]}")

    def _answer(self, seconds):
        ready, _, _ = select.select([self._child.stdout], [], [], seconds)
        line = self._child.stdout.readline() if ready else ""
        if line:
            return json.loads(line)
        child = self._child
        if ready:
            child.wait()
        self.close()
        code = child.returncode
        self.ended = f"no answer within {seconds:g} s" if not ready else f"exit {code}"
        if ready and code < 0:
            self.ended = signal.Signals(-code).name
        return None


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one command."""

    exit: int | str
    """Exit code; a traceback where an exception came out, or how the process ended."""
    text: str = ""
    """Everything on standard output and standard error."""
    peak: int = 0
    """Most memory resident, bytes."""
    threads: tuple[str, ...] = ()
    """Python threads that were left running."""

    @property
    def errors(self):
        """Lines that begin an error message."""
        return [line for line in self.text.splitlines() if line.startswith("Error: ")]


class Runner:
    """Runs commands of bumpymap in a child process; ``folder`` is its own."""

    def __init__(self, folder: Path) -> None:
        self.scratch = folder / "scratch"
        self.scratch.mkdir()
        good = folder / "good.las"
        good.write_bytes(bases()["las12.las"])
        environment = {"TMPDIR": str(self.scratch), "COLUMNS": "200"}
        self._lines = Lines([_DRIVER, good, folder / "good_out", MEMORY], SECONDS, environment, folder / "said")
        self.close = self._lines.close

    def run(self, *argv):
        """Outcome of one command."""
        said = self._lines.ask([str(word) for word in argv])
        return Outcome(self._lines.ended) if said is None else Outcome(**said)
