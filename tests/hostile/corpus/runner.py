"""A process that answers questions under limits of memory and time: commands of bumpymap, or readings by the fuzzer."""

import contextlib
import multiprocessing
import os
import resource
import signal
import sys
import threading
import traceback
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from unittest.mock import patch

from .files import bases

SECONDS = 10.0
MEMORY = 1_500_000_000
"""Bytes that a question may take."""
_STARTING = 300.0
"""Seconds for the first run of all, which loads libraries."""
_POOLS = dict.fromkeys(("RAYON_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MALLOC_ARENA_MAX"), "1")
"""One thread each: the pools of libraries would reserve memory for as many as the machine has cores."""


class Child:
    """A process that is killed when it hangs, and started again when it died.

    ``warm``: what it does first, before its memory is limited, which loads libraries; ``answer``: gives the answer to a
    question; ``seconds``: for each; ``said``: the file to which it writes; ``environment``: variables of its own.
    """

    def __init__(self, warm, answer, seconds: float, said: Path, **environment: str) -> None:
        self._work, self._seconds, self.said, self._environment = (warm, answer), seconds, said, environment
        self._process = None
        self.ended = ""
        """How the process ended, after an answer that did not come."""

    def ask(self, question):
        """Give the answer; None where the process died or hung."""
        if self._process is None:
            self._start()
        with contextlib.suppress(BrokenPipeError):
            self._pipe.send(question)
        return self._answer(self._seconds)

    def close(self):
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None

    def _start(self):
        spawn = multiprocessing.get_context("spawn")
        self._pipe, other = spawn.Pipe()
        self._process = spawn.Process(target=_serve, args=(other, *self._work, self.said))
        with patch.dict(os.environ, _POOLS | self._environment):
            self._process.start()
        other.close()
        if self._answer(_STARTING) != "ready":
            raise RuntimeError(f"the process does not start: {self.ended}\n{self.said.read_text()[-4000:]}")

    def _answer(self, seconds):
        process, self.ended = self._process, f"no answer within {seconds:g} s"
        try:
            if self._pipe.poll(seconds):
                return self._pipe.recv()
        except (EOFError, ConnectionResetError):
            process.join()
            code = process.exitcode
            self.ended = signal.Signals(-code).name if code < 0 else f"exit {code}"
        self.close()
        return None


# ---- in the process ----

_SAID = 2
"""The file to which descriptors 1 and 2 write, themselves: a panic in Rust writes to them past ``sys.stderr``."""


def _serve(pipe, warm, answer, said):
    """Warm up, refuse memory beyond the budget, say "ready", and answer."""
    file = os.open(said, os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    os.dup2(file, 1)
    os.dup2(file, _SAID)
    warm()
    most = _size_of("VmSize") - _size_of("VmRSS") + MEMORY  # what is reserved counts, touched or not
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    pipe.send("ready")
    with contextlib.suppress(EOFError):
        while True:
            question = pipe.recv()
            os.ftruncate(_SAID, 0)
            os.lseek(_SAID, 0, os.SEEK_SET)
            pipe.send(answer(question))


def _size_of(what):
    """Look a size of this process up, in bytes."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(f"{what}:"))


def text_said():
    """What was written since the last question."""
    return os.pread(_SAID, os.fstat(_SAID).st_size, 0).decode("utf-8", "replace")


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


def _run(argv):
    """Give the exit code of a command, or the traceback of what came out instead."""
    from bumpymap.cli import main

    try:
        main.main(args=argv, prog_name="bumpymap", standalone_mode=True)
    except SystemExit as end:
        return 0 if end.code is None else end.code
    except BaseException:  # noqa: BLE001 (a Rust panic is no Exception; nothing at all may come out)
        return traceback.format_exc()
    return 0


def _watched(argv):
    """Run a command; exit, output, memory (with the child that decodes) and threads."""
    from bumpymap.readers.decoder import close_decoder

    threads = set(threading.enumerate())
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # forgets the peak
    code = _run(argv)
    sys.stdout.flush()
    sys.stderr.flush()
    close_decoder()  # the largest child that has ended counts, too; children have the same limit each
    peak = _size_of("VmHWM") + resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    left = tuple(thread.name for thread in set(threading.enumerate()) - threads)
    return Outcome(code, text_said(), peak, left)


def _map_good(good, out):
    patch("bumpymap.views.write_map_views", lambda *_: None).start()  # of maps, layers alone: twice as fast
    for argv in (["map", good, "--out", out, "--local", "--threads", "1", "--overwrite"], ["info", good]):
        if _run(argv) != 0:
            raise RuntimeError("a valid survey cannot be read")


class Runner:
    """Runs commands of bumpymap in a child process; ``folder`` is its own."""

    def __init__(self, folder: Path) -> None:
        self.scratch, good = folder / "scratch", folder / "good.las"
        self.scratch.mkdir()
        good.write_bytes(bases()["las12.las"])
        warm = partial(_map_good, str(good), str(folder / "good_out"))
        self._child = Child(warm, _watched, SECONDS, folder / "said", TMPDIR=str(self.scratch), COLUMNS="200")
        self.close = self._child.close

    def run(self, *argv):
        """Outcome of one command."""
        return self._child.ask([str(word) for word in argv]) or Outcome(self._child.ended)
