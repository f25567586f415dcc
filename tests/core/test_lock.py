"""The lock of a folder: one holder at a time, whoever comes and goes, and no link is followed."""

import errno
import fcntl
import json
import os
import re
import stat
import subprocess
import sys

import pytest

from bumpymap.core.errors import OutputError
from bumpymap.core.run_folder import LOCK, Holder, lock_for, locked

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
    lock_for(Holder(7, "bumpymap batch flights"))
    try:
        with locked(tmp_path), pytest.raises(OutputError, match=r"pid 7 on .* since .*: bumpymap batch flights"):
            locked(tmp_path).__enter__()
    finally:
        lock_for(None)


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
