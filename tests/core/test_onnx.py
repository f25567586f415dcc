"""Networks: ONNX Runtime leaves, sends and says nothing; a damaged one is refused."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bumpymap.core import BadInputError, shipped_network
from bumpymap.rating.textures import TextureModel
from bumpymap.scan import ScanModel

onnx = pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")
helper = pytest.importorskip("onnx.helper")

SURVEY = Path(__file__).resolve().parents[2] / "sample_data" / "quarry_part.ply"
SWITCHES = {"CI", "ORT_DISABLE_TELEMETRY", "ORT_RUNNING_UNIT_TESTS"}
"""Variables that keep the telemetry off by themselves."""
PROGRAM = [sys.executable, "-m", "bumpymap", "map", str(SURVEY), "--local", "--xy-unit", "m", "--quiet", "--out"]


@pytest.fixture
def home(tmp_path):
    for name in ("home", "cache", "scratch"):
        (tmp_path / "place" / name).mkdir(parents=True)
    return tmp_path / "place"


def variables(home):
    """A user who has set nothing."""
    kept = {name: value for name, value in os.environ.items() if name not in SWITCHES}
    return kept | {"HOME": str(home / "home"), "XDG_CACHE_HOME": str(home / "cache"), "TMPDIR": str(home / "scratch")}


@pytest.mark.slow
def test_a_run_leaves_no_file_and_says_nothing_where_it_shall_be_quiet(tmp_path, home):
    line = [*PROGRAM, tmp_path / "out"]
    done = subprocess.run(line, env=variables(home), capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    assert [path for path in home.rglob("*") if not path.is_dir()] == []


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


def another_output(model):
    last = model.graph.node[-1]
    last.output[0] = "before"
    model.graph.node.append(helper.make_node("Concat", ["before", "before"], ["probability"], axis=1))


def huge(model):
    for number in range(40):
        source = f"d{number}" if number else "probability"
        model.graph.node.append(helper.make_node("Concat", [source, source], [f"d{number + 1}"], axis=1))
    model.graph.output[0].name = "d40"


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (another_output, "it gives float32"),
        pytest.param(huge, "takes|memory|alloc|finish|crashed", marks=pytest.mark.later),
    ],
)
@pytest.mark.parametrize("kind", ["textures", "scan"])
def test_a_network_that_gives_something_else_is_refused(tmp_path, kind, spoil, words):
    path = tmp_path / "odd.onnx"
    model = onnx.load_model_from_string(shipped_network("rating" if kind == "textures" else "scan", f"{kind}.onnx"))
    spoil(model)
    path.write_bytes(model.SerializeToString())
    load = TextureModel.load if kind == "textures" else ScanModel.load
    with pytest.raises(BadInputError, match=words) as caught:
        load(path)
    assert f"{path} is not an ONNX model that bumpymap runs" in str(caught.value)
