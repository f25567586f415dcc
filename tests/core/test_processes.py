"""Child processes, signals, memory and locked folders: one clear error, nothing left running or half-known."""

import errno
import fcntl
import hashlib
import json
import os
import re
import signal
import stat
import subprocess
import sys

import numpy as np
import pytest
from blake3 import blake3
from hypothesis import given, settings, strategies as st

from bumpymap.core import OutputError, free_memory, same_content
from bumpymap.core.processes import Child, ChildDiedError, ChildError, SharedMemory
from bumpymap.core.run_folder import LOCK, RunFolder, lock_for, locked, work_folder
from bumpymap.readers import hash_survey


@pytest.fixture
def child():
    """A child that calls functions of ``os``."""
    made = Child("to test", "os", [])
    yield made
    made.close()


def said_by(code, **options):
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, **options)


def test_what_a_function_raises_is_told_and_the_child_goes_on(child):
    with pytest.raises(ChildError, match="No such file"):
        child.call("listdir", "/none")
    with pytest.raises(ChildError, match="no attribute"):
        child.call("none")
    assert child.is_alive


@pytest.mark.parametrize(
    ("question", "message", "name"),
    [(("_exit", 3), r"ended by itself \(code 3\)", ""), (("abort",), "was ended by SIGABRT", "SIGABRT")],
)
def test_a_child_that_dies_is_told(child, question, message, name):
    with pytest.raises(ChildDiedError, match=message) as error:
        child.call(*question)
    assert error.value.signal == name
    assert not child.is_alive
    with pytest.raises(ChildDiedError, match=message):
        child.call("getpid")


@pytest.mark.skipif(sys.platform != "linux", reason="limits are those of Linux")
def test_a_request_for_more_memory_than_allowed_fails_alone():
    child = Child("to test", "builtins", [])
    with pytest.raises(ChildError, match="MemoryError"):
        child.call("bytes", 1 << 30, memory=200 << 20)
    assert child.call("len", b"12", memory=200 << 20) == 2
    child.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_are_for_the_parent(child, number):
    child.call("getpid")
    child.process.send_signal(number)
    assert child.call("getpid") == child.process.pid


# --- signals ---
BEGIN = """
import os, signal, sys, weakref
from bumpymap.core.interrupts import interruptible, shielded

def hit(*_):
    os.kill(os.getpid(), signal.{name})
    for _ in range(10): pass  # the handler runs between two steps
"""
LOST = {
    "in a finaliser": "class Dies:\n    __del__ = hit\nDies()",
    "in a callback of a weak reference": "class Dies: pass\none = Dies()\nref = weakref.ref(one, hit)\ndel one",
}
BODIES = [
    # A second signal does not break the clearing up; who insists is heard.
    ("try:\n    hit()\nfinally:\n    hit()\n    print('cleared')", 9, ["cleared", "Terminated"]),
    (
        "try:\n    hit()\nfinally:\n    hit()\n    hit()\n    print('deaf')\n    hit()\n    print('never')",
        9,
        ["deaf", "Terminated"],
    ),
    # An error that a library makes of a signal is the signal.
    ("try:\n    hit()\nexcept KeyboardInterrupt:\n    raise ImportError('initialization failed')", 9, ["Terminated"]),
    (
        "with shielded():\n    with shielded():\n        hit()\n    print('whole')\nprint('never')",
        9,
        ["whole", "Terminated"],
    ),
    # A forked child ends as any process does.
    (
        "child = os.fork()\nif not child:\n    hit()\nprint(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))",
        0,
        [str(-signal.SIGTERM)],
    ),
]


def ended(name, body):
    """Run a body, and give the exit code and what was said."""
    code = BEGIN.format(name=name) + "\ntry:\n    with interruptible():\n"
    code += "".join(f"        {line}\n" for line in body.splitlines())
    done = said_by(f"{code}except KeyboardInterrupt as end:\n    print(type(end).__name__)\n    sys.exit(9)\n")
    return done.returncode, done.stdout.split(), done.stderr


@pytest.mark.parametrize(("name", "word"), [("SIGTERM", "Terminated"), ("SIGINT", "Interrupted")])
@pytest.mark.parametrize("where", LOST)
def test_a_signal_that_the_interpreter_loses_comes_again(name, word, where):
    assert ended(name, LOST[where] + "\nwhile True: pass") == (9, [word], "")


@pytest.mark.parametrize(("body", "code", "said"), BODIES)
def test_a_signal_ends_a_run_once_and_lets_it_clear_up(body, code, said):
    assert ended("SIGTERM", body) == (code, said, "")


def test_a_run_that_is_over_leaves_signals_as_they_were():
    code, said, error = ended("SIGTERM", LOST["in a finaliser"])  # lost, and over before it comes again
    assert (code, said, error) in ((0, [], ""), (9, ["Terminated"], ""))
    done = said_by(BEGIN.format(name="SIGTERM") + "with interruptible(): pass\nhit()")
    assert (done.returncode, done.stderr) == (-signal.SIGTERM, "")


def test_the_command_ends_without_a_word_before_it_listens(tmp_path):
    (tmp_path / "click.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nwhile True: pass")
    begin = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); sys.argv = ['', '--help']; "
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, sys.path)])}
    done = said_by(begin + "from bumpymap.__main__ import run; run()", env=env)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


# --- memory ---
SIZES = st.integers(0, 40_000)


@settings(deadline=None, max_examples=60)
@given(steps=st.lists(st.one_of(SIZES, st.tuples(SIZES)), max_size=40))
def test_arrays_keep_their_content_until_they_are_dropped_and_then_their_place_can_be_given_back(steps):
    """A size takes so many bytes; a size in a tuple drops one of those that are held."""
    memory, held = SharedMemory(), []
    for number, step in enumerate(steps):
        if isinstance(step, tuple):
            if held:
                held.pop(step[0] % len(held))
                memory.trim()
            continue
        part = memory.allocate(step)
        part.data[:] = number % 251
        # A view of a view: the part itself is gone.
        held.append((part.data[:].reshape(-1)[: step // 2], number % 251))
    for data, value in held:
        assert (data == value).all()
    held = data = part = None
    for _ in range(9):
        memory.allocate(1 << 20)  # and dropped at once
    assert memory.size < 9 << 20
    memory.trim()
    assert memory.size == 0


def test_a_map_that_no_memory_is_left_for_leaves_the_one_that_is_there():
    memory = SharedMemory()
    held = memory.allocate(1000)
    for _ in range(2):  # as two threads that ask one after the other
        with pytest.raises(OSError, match="Cannot allocate memory"):
            memory.allocate(1 << 60)
    held.data[:] = 7
    assert memory.allocate(1 << 20).data.size == 1 << 20
    assert (held.data == 7).all()


GIB = 1 << 30
ROOT_OF_A_CONTAINER = {"memory.max": f"{2 * GIB}\n", "memory.current": f"{3 * GIB}\n"}
TWO_GROUPS = {
    "a/b/memory.max": f"{8 * GIB}",
    "a/b/memory.current": f"{GIB}",
    "a/memory.max": f"{6 * GIB}",
    "a/memory.current": f"{5 * GIB}",
    "a/memory.stat": f"anon {GIB}\ninactive_file {3 * GIB}\n",
}
FIRST_VERSION = {
    "memory/jobs/memory.limit_in_bytes": f"{3 * GIB}\n",
    "memory/jobs/memory.usage_in_bytes": f"{2 * GIB}\n",
    "memory/jobs/memory.stat": f"inactive_file 7\ntotal_inactive_file {GIB}\n",
}


def system(monkeypatch, folder, groups, files, available=64 * GIB):
    """Write what Linux would show: the groups of the process, and files by path."""
    meminfo = f"MemTotal: 99 kB\nMemAvailable:   {available // 1024} kB\nHugePages_Total: 0\n"
    files = {f"cgroup/{path}": text for path, text in files.items()}
    for path, text in {"proc/meminfo": meminfo, "proc/self/cgroup": groups, **files}.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)
    monkeypatch.setattr("bumpymap.core.memory._PROC", folder / "proc")
    monkeypatch.setattr("bumpymap.core.memory._CGROUPS", folder / "cgroup")


@pytest.mark.parametrize(
    ("groups", "files", "available", "free"),
    [
        ("0::/user\n", {"user/memory.max": "max\n", "user/memory.current": "5\n"}, 64, 64),  # no limit
        ("0::/a/b\n", TWO_GROUPS, 64, 4),  # the tightest group counts, and copies of files are no use
        ("0::/a/b\n", TWO_GROUPS, 2, 2),
        ("5:cpu,cpuacct:/elsewhere\n4:memory:/jobs/one\n0::/\n", FIRST_VERSION, 64, 2),
        ("0::/docker/0123\n", ROOT_OF_A_CONTAINER, 64, 0),
        ("0::/../../other\n", ROOT_OF_A_CONTAINER, 64, 0),
        ("0::/a\n", {"a/memory.max": "", "a/memory.current": "many"}, 64, 64),  # damaged files are no limits
    ],
)
def test_what_is_free_on_a_machine_or_in_a_container(monkeypatch, tmp_path, groups, files, available, free):
    system(monkeypatch, tmp_path, groups, files, available * GIB)
    assert free_memory() == free * GIB


def test_a_machine_that_says_nothing_has_what_is_installed(monkeypatch, tmp_path):
    system(monkeypatch, tmp_path, "0::/a\n", {})
    (tmp_path / "proc" / "meminfo").write_text("MemTotal: 1 kB\n")
    assert (installed := free_memory()) is None or installed > 1 << 20
    monkeypatch.setattr("bumpymap.core.memory._PROC", tmp_path / "none")
    assert free_memory() == installed


# ---- the folder of a run ----


HOLD = """
import sys
from pathlib import Path
from bumpymap.core.run_folder import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the lock of ``out``."""
    words = [sys.executable, "-c", HOLD, str(tmp_path / "out"), "a word"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.stdin.close()


def test_the_loser_says_who_holds_it(tmp_path, holder):
    out = tmp_path / "out"
    before = (out / LOCK).read_bytes()
    assert stat.S_IMODE((out / LOCK).stat().st_mode) == 0o600
    with pytest.raises(OutputError) as refused, locked(out):
        pass
    said = str(refused.value)
    assert re.search(rf"another run is writing to {re.escape(str(out))}: pid {holder.pid} on \S+ since \d\d\d\d-", said)
    assert "'a word'" in said
    assert "`out`" in said
    assert (out / LOCK).read_bytes() == before


def test_a_worker_holds_the_lock_in_the_name_of_the_command(tmp_path):
    lock_for({"pid": 7, "command": "bumpymap batch flights"})
    try:
        with locked(tmp_path), pytest.raises(OutputError, match=r"pid 7 on .* since .*: bumpymap batch flights"):
            locked(tmp_path).__enter__()
    finally:
        lock_for({})


def test_the_lock_of_a_killed_run_holds_nobody_up(tmp_path, holder):
    out = tmp_path / "out"
    holder.kill()
    holder.wait()
    assert (out / LOCK).exists()
    with locked(out):
        assert json.loads((out / LOCK).read_text())["pid"] == os.getpid()
    assert list(out.iterdir()) == []


def test_a_lock_that_is_taken_away_by_its_holder_is_taken_anew(tmp_path, monkeypatch):
    """The holder ends between the opening and the locking of the file: with its folder, or without."""
    out = tmp_path / "out"
    for ending in ((out / LOCK).unlink, lambda: ((out / LOCK).unlink(), out.rmdir())):
        out.mkdir(exist_ok=True)
        (out / LOCK).touch()
        endings = [ending]
        take = fcntl.flock

        def late(descriptor, how, endings=endings, take=take):
            if endings:
                endings.pop()()
            take(descriptor, how)

        with monkeypatch.context() as patch:
            patch.setattr(fcntl, "flock", late)
            with locked(out):
                assert not endings
                assert json.loads((out / LOCK).read_text())["pid"] == os.getpid()
                with pytest.raises(OutputError, match=f"pid {os.getpid()}"), locked(out):
                    pass
    assert list(out.iterdir()) == []


@pytest.mark.parametrize("kind", ["link", "dangling", "hard link", "pipe", "folder"])
def test_what_is_no_lock_file_is_left_alone(tmp_path, kind):
    out, other = tmp_path / "out", tmp_path / "other"
    out.mkdir()
    other.write_text("mine")
    if kind == "folder":
        (out / LOCK).mkdir()
    elif kind == "pipe":
        os.mkfifo(out / LOCK)
    elif kind == "hard link":
        os.link(other, out / LOCK)
    else:
        (out / LOCK).symlink_to(other if kind == "link" else tmp_path / "none")
    with pytest.raises(OutputError, match="is not a lock file"), locked(out):
        pass
    assert other.read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other", "out"]


def test_a_disk_without_locks_takes_the_file_for_the_lock(tmp_path, monkeypatch):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    out = tmp_path / "out"
    with locked(out), pytest.raises(OutputError, match=rf"pid {os.getpid()}.*remove .*{LOCK}"), locked(out):
        pass
    with locked(out):
        pass


@pytest.mark.parametrize("spec", ['{"inputs": 5, "settings": {}, "made with": {}}', '{"settings": "x"}', "[1]", "{"])
def test_a_damaged_run_spec_is_not_resumed(tmp_path, spec):
    folder = work_folder(tmp_path)
    folder.mkdir(mode=0o700)
    (folder / "run_spec.json").write_text(spec)
    now = {"inputs": {"a.las": {"size": 1}}, "settings": {"x": 1}, "made with": {}}
    with RunFolder.opened(tmp_path, now, overwrite=False, finished=lambda _: True, advice="") as run:
        assert not run.resumed


# --- the checksum of a file ---
PIECE = 1 << 20


@pytest.mark.parametrize("size", [0, 1000, PIECE, 5 * PIECE + 12_345])
def test_the_checksum_of_a_file_is_its_blake3(size, tmp_path):
    data = np.random.default_rng(size).bytes(size)
    (tmp_path / "a").write_bytes(data)
    assert hash_survey(tmp_path / "a") == f"blake3:{blake3(data).hexdigest()}"


def test_content_is_compared_by_the_method_of_the_record(tmp_path):
    path, data = tmp_path / "site.las", np.random.default_rng(5).bytes(1005)
    path.write_bytes(data)
    here = {"size": len(data), "mtime_ns": "2"}
    for name, digest in (("checksum", hash_survey(path)), ("sha256", hashlib.sha256(data).hexdigest())):
        assert same_content(str(path), {"bytes": len(data), "mtime_ns": "1", name: digest}, here, hash_survey)
        assert not same_content(str(path), {"mtime_ns": "1", name: digest[:-1] + "x"}, here, hash_survey)
    for known in ({"checksum": "other:12"}, {"checksum": None}, {}):
        assert not same_content(str(path), {"mtime_ns": "1", **known}, here, hash_survey)
