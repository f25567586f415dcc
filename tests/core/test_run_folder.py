"""The folder of a run: one holder at a time, whatever was begun is known again; and the checksums of its inputs."""

import errno
import fcntl
import hashlib
import json
import os
import re
import stat
import subprocess
import sys

import numpy as np
import pytest
from blake3 import blake3

from bumpymap.core import same_content
from bumpymap.core.errors import OutputError
from bumpymap.core.run_folder import LOCK, RunFolder, lock_for, locked, work_folder
from bumpymap.readers import hash_survey

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


def content(size):
    return np.random.default_rng(size).bytes(size)


def expected(data):
    return f"blake3:{blake3(data).hexdigest()}"


@pytest.mark.parametrize("size", [0, 1000, PIECE, 5 * PIECE + 12_345])
def test_the_checksum_of_a_file_is_its_blake3(size, tmp_path):
    data = content(size)
    (tmp_path / "a").write_bytes(data)
    assert hash_survey(tmp_path / "a") == expected(data)


def test_content_is_compared_by_the_method_of_the_record(tmp_path):
    path = tmp_path / "site.las"
    path.write_bytes(content(PIECE + 5))
    here = {"size": PIECE + 5, "mtime_ns": "2"}
    data = path.read_bytes()
    for known in ({"checksum": expected(data)}, {"sha256": hashlib.sha256(data).hexdigest()}):
        assert same_content(str(path), {"bytes": PIECE + 5, "mtime_ns": "1", **known}, here, hash_survey)
        (name,) = known
        assert not same_content(str(path), {"mtime_ns": "1", name: known[name][:-1] + "x"}, here, hash_survey)
    assert not same_content(str(path), {"mtime_ns": "1", "checksum": "other:12"}, here, hash_survey)
    assert not same_content(str(path), {"mtime_ns": "1", "checksum": None}, here, hash_survey)
    assert not same_content(str(path), {"mtime_ns": "1"}, here, hash_survey)
