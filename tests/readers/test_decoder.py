"""The decoder in a process of its own: nothing that it does harms this one."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from bumpymap.core import BadInputError, Child, UsageError, processes
from bumpymap.core.processes import Guard, SharedMemory
from bumpymap.readers import decoder, open_survey
from bumpymap.readers.decoder import Decoder

CORNER = np.array([500_000.0, 4_000_000.0, 0.0])


@pytest.fixture
def child(monkeypatch):
    """A decoder of this test alone, and memory without arrays of tests before this one."""
    monkeypatch.setattr(processes, "MEMORY", SharedMemory())
    made = Decoder()
    monkeypatch.setattr(decoder, "current", made)
    yield made
    made.close()


@pytest.fixture
def survey(las):
    """LAZ of points in chunks of 300, or of any size."""

    def write(name="a.las", count=4000, **chunks):
        points = np.random.default_rng(0).uniform(0, 100, (count, 3)) + CORNER
        return las.pack(las.write(name, points, version="1.4", fmt=7), **(chunks or {"chunk": 300}))

    return write


def records(reader, points=700):
    return [reader.fetch(chunk).copy() for chunk in reader.chunks(points)]


def same(found, expected):
    return all(np.array_equal(one, other) for one, other in zip(found, expected, strict=True))


def pid_of(child):
    return child.guards[-1].child.process.pid


@pytest.mark.parametrize(
    ("number", "error", "message"),
    [
        (signal.SIGSEGV, BadInputError, r"bad\.laz: the decoder crashed \(SIGSEGV\).*damaged"),
        (signal.SIGKILL, UsageError, r"was killed \(SIGKILL\)"),  # from outside: no fault of the file
    ],
)
def test_a_file_that_kills_the_decoder_is_refused_and_the_next_is_read(
    survey, child, monkeypatch, number, error, message
):
    bad, good = survey("bad.las"), survey("good.las")
    expected = records(open_survey(good))
    reader = open_survey(bad)
    ask = child._call

    def die(*args, **more):
        os.kill(pid_of(child), number)
        return ask(*args, **more)

    with monkeypatch.context() as patch:
        patch.setattr(Guard, "is_alive", True)  # does not look whether it lives
        patch.setattr(child, "_call", die)
        with pytest.raises(error, match=message):
            reader.fetch(reader.chunks()[0])
    assert same(records(open_survey(good)), expected)


def test_a_decoder_that_comes_to_no_end_or_is_interrupted_leaves_no_answer_for_the_next(survey, child, monkeypatch):
    # So many points that they take several ticks of the clock that counts processor time.
    reader = open_survey(survey(count=200_000, chunk=100_000))
    first, second = reader.chunks(100_000)
    expected = reader.fetch(second).copy()
    with monkeypatch.context() as patch:
        patch.setattr(decoder, "SECONDS", 1e-6)
        patch.setattr(decoder, "SECONDS_PER_BYTE", 0.0)
        with pytest.raises(BadInputError, match=r"a\.laz: the decoder did not finish"):
            reader.fetch(first)
    assert np.array_equal(reader.fetch(second), expected)

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Child, "finish", interrupted)
        with pytest.raises(KeyboardInterrupt):
            reader.fetch(first)
    assert np.array_equal(reader.fetch(second), expected)


def test_chunks_that_are_requested_at_once_are_decoded_by_several_children(survey, child):
    reader = open_survey(survey(count=200_000, chunk=4000))
    expected = records(reader, 4000)
    assert reader.info.parallel
    with ThreadPoolExecutor(3) as pool:
        assert same(list(pool.map(reader.fetch, reader.chunks(4000))), expected)
    used = [guard.child.process.pid for guard in child.guards if guard.is_alive]
    assert len(used) > 1
    child.close()
    assert all(map(ended, used))


def test_a_fork_has_a_child_of_its_own(survey, child):
    reader = open_survey(survey())
    expected, mine = records(reader), pid_of(child)
    forked = os.fork()
    if forked == 0:
        right = same(records(reader), expected) and pid_of(decoder.decoder()) != mine
        decoder.close_decoder()
        os._exit(0 if right else 1)
    assert os.waitpid(forked, 0)[1] == 0
    assert same(records(reader), expected)
    assert pid_of(child) == mine


def ended(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    with Path(f"/proc/{pid}/stat").open() as file:  # a child whose parent has not asked for it yet
        return file.read().rpartition(")")[2].split()[0] == "Z"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("how", ["signal.SIGKILL", None])
def test_no_child_outlives_its_parent(survey, how):
    code = f"""
        import os, signal, sys
        from pathlib import Path
        from bumpymap.readers import decoder, open_survey
        open_survey(Path(sys.argv[1]))
        print(decoder.decoder().guards[-1].child.process.pid, flush=True)
        {f"os.kill(os.getpid(), {how})" if how else ""}
    """
    command = [sys.executable, "-c", textwrap.dedent(code), str(survey())]
    pid = int(subprocess.run(command, capture_output=True, text=True, check=False).stdout)
    for _ in range(500):
        if ended(pid):
            return
        time.sleep(0.01)
    pytest.fail("the decoder runs on")
