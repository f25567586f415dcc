"""Machines that give little: one message, exit code 3, never a traceback, never "the file is damaged"."""

import errno
import re
import subprocess
import sys
from pathlib import Path

import pytest

from bumpymap.cli._exit_code import exit_code_of
from bumpymap.core.errors import BadInputError, OutputError, missing_resource

ROOT = Path(__file__).resolve().parents[2]
QUARRY = ROOT / "sample_data" / "quarry.laz"
COMMAND = [sys.executable, "-c", "from bumpymap.cli import main; main()"]
linux = pytest.mark.skipif(sys.platform != "linux", reason="limits are those of Linux")


def shell(line, *words):
    command = ["sh", "-c", f'{line} && exec "$@"', "sh", *COMMAND, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def commands(folder):
    points = "".join(f"{x} {y} {(x * y) % 3 * 0.1}\n" for x in range(-20, 20) for y in range(-20, 20))
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1600\nHEIGHT 1\nPOINTS 1600\n"
    (folder / "scan.pcd").write_text(f"{head}DATA ascii\n{points}")
    return {
        "info": ["info", QUARRY],
        "map": ["map", QUARRY, "--out", folder / "layers"],
        "scan": ["scan", folder / "scan.pcd", "--out", folder / "scanned"],
    }


def check(done):
    assert done.returncode in {0, 3}, done.stderr
    assert "Traceback" not in done.stderr
    assert "damaged" not in done.stderr + done.stdout
    if done.returncode:
        # ONNX Runtime warns on its own where it cannot look at the devices of the machine. A slow machine, and one that
        # has not compiled the kernels yet, is told how far it is.
        said = [line for line in done.stderr.splitlines() if "onnxruntime" not in line]
        own = [line for line in said if not re.match(r"\d+:\d\d:\d\d ", line)]
        assert [line[:7] for line in own] == ["Error: "]


@pytest.mark.later
@linux
@pytest.mark.parametrize("command", ["info", "map", "scan"])
@pytest.mark.parametrize("kilobytes", [200_000, 800_000])
def test_little_memory(tmp_path, command, kilobytes):
    done = shell(f"ulimit -v {kilobytes}", *commands(tmp_path)[command])
    check(done)
    assert done.returncode == 0 or "no memory left" in done.stderr or "no thread left" in done.stderr
    if done.returncode:
        assert not (tmp_path / "layers" / "run.json").exists()


@pytest.mark.namespaces
@pytest.mark.parametrize("command", ["info", "map", "scan"])
def test_no_shared_memory(tmp_path, command):
    mount = "mount -t tmpfs -o size=4k tmpfs /dev/shm"
    words = map(str, commands(tmp_path)[command])
    line = ["unshare", "-m", "sh", "-c", f'{mount} && exec "$@"', "sh", *COMMAND, *words]
    done = subprocess.run(line, capture_output=True, text=True, timeout=300, check=False)
    assert "Traceback" not in done.stderr
    assert done.returncode == 0, done.stderr


def chained(outer, inner):
    outer.__cause__ = inner
    return outer


@pytest.mark.parametrize(
    ("error", "what"),
    [
        (MemoryError(), "memory"),
        (RuntimeError("can't start new thread"), "thread"),
        (OSError(errno.EMFILE, "Too many open files"), "file that may be opened"),
        (BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"), "process"),
        (ImportError("libx.so: failed to map segment from shared object"), "memory"),
        (chained(BadInputError("no network"), ImportError("failed to map segment")), "memory"),
        (chained(OutputError("cannot write"), OSError(errno.ENOMEM, "Cannot allocate memory")), "memory"),
        (chained(OutputError("cannot write"), OSError(errno.ENOSPC, "No space left on device")), ""),
        (OSError(errno.EFBIG, "File too large"), ""),
        (RuntimeError("anything"), ""),
    ],
)
def test_what_a_machine_lacks_is_told_from_what_a_file_lacks(error, what, capsys):
    assert missing_resource(error) == what

    def fail():
        raise error

    if type(error) is RuntimeError and not what:
        with pytest.raises(RuntimeError):
            exit_code_of(fail, [])
        return
    assert exit_code_of(fail, []) == 3
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert (f"the machine has no {what} left" in said[0]) == bool(what)


@pytest.mark.later
@linux
@pytest.mark.parametrize("command", ["info", "map", "scan", "batch"])
def test_a_limit_on_the_size_of_files_is_no_damage_and_no_full_disk(tmp_path, command):
    words = {**commands(tmp_path), "batch": ["batch", QUARRY.parent, "--out", tmp_path / "night"]}[command]
    done = shell("ulimit -f 1", *words)
    assert done.returncode == 3
    first = done.stderr.splitlines()[0]
    assert "ulimit -f" in first
    assert "damaged" not in first
    assert "Free some space" not in first
