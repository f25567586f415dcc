"""ONNX Runtime leaves nothing, sends nothing, says nothing."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

SURVEY = Path(__file__).resolve().parents[2] / "sample_data" / "quarry_part.ply"
SWITCHES = {"CI", "ORT_DISABLE_TELEMETRY", "ORT_RUNNING_UNIT_TESTS"}
"""Variables that keep the telemetry off by themselves."""
PROGRAM = [sys.executable, "-m", "bumpymap", "map", str(SURVEY), "--local", "--quiet", "--out"]


@pytest.fixture
def home(tmp_path):
    for name in ("home", "cache", "scratch"):
        (tmp_path / "place" / name).mkdir(parents=True)
    return tmp_path / "place"


def variables(home):
    """A user who has set nothing."""
    kept = {name: value for name, value in os.environ.items() if name not in SWITCHES}
    return kept | {"HOME": str(home / "home"), "XDG_CACHE_HOME": str(home / "cache"), "TMPDIR": str(home / "scratch")}


def test_a_run_leaves_no_file_and_says_nothing_where_it_shall_be_quiet(tmp_path, home):
    line = [*PROGRAM, tmp_path / "out"]
    done = subprocess.run(line, env=variables(home), capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    assert [path for path in home.rglob("*") if not path.is_dir()] == []


def test_no_thread_is_left_that_could_send_something(home):
    code = (
        "import os, numpy\n"
        "before = len(os.listdir('/proc/self/task'))\n"
        "from bumpymap.core.onnx_file import session, shipped_network\n"
        "session(shipped_network('rating', 'textures.onnx'))\n"
        "print(len(os.listdir('/proc/self/task')) - before)"
    )
    if not Path("/proc/self/task").is_dir():
        pytest.skip("threads are counted in /proc, which is Linux's")
    done = subprocess.run([sys.executable, "-c", code], env=variables(home), capture_output=True, text=True, check=True)
    assert done.stdout == "0\n"


@pytest.mark.namespaces
@pytest.mark.skipif(shutil.which("strace") is None, reason="needs strace")
def test_a_run_without_a_network_never_asks_for_one(tmp_path, home):
    traced = ["unshare", "--net", "--", "strace", "--follow-forks", "--trace=network,%file", "--output", "trace"]
    line = [*traced, *PROGRAM, tmp_path / "out"]
    done = subprocess.run(line, cwd=tmp_path, env=variables(home), capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    calls = (tmp_path / "trace").read_text(encoding="utf-8", errors="replace").splitlines()
    assert any("textures.onnx" in call or "onnxruntime" in call for call in calls)
    assert [call for call in calls if "connect(" in call or "sendto(" in call or "sendmsg(" in call] == []
    assert [call for call in calls if "deviceid" in call or "/.ses" in call] == []
