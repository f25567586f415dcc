"""Networks: ONNX Runtime leaves, sends and says nothing; one of others names no other file and needs little memory."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bumpymap.core import BadInputError
from bumpymap.core.onnx_file import shipped_network
from bumpymap.rating.textures import TextureModel
from bumpymap.scan import ScanModel

onnx = pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")
helper = pytest.importorskip("onnx.helper")

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


@pytest.mark.slow
def test_a_run_leaves_no_file_and_says_nothing_where_it_shall_be_quiet(tmp_path, home):
    line = [*PROGRAM, tmp_path / "out"]
    done = subprocess.run(line, env=variables(home), capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    assert [path for path in home.rglob("*") if not path.is_dir()] == []


@pytest.mark.slow
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


# --- networks of others ---
LARGE = 1 << 36


def external(tensor):
    tensor.ClearField("raw_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    for key, value in {"location": "../secret.bin", "offset": "0", "length": "4"}.items():
        tensor.external_data.add(key=key, value=value)
    return tensor


def a_tensor(name="w", shape=(1,)):
    return helper.make_tensor(name, onnx.TensorProto.FLOAT, shape, np.zeros(shape, "<f4").tobytes(), raw=True)


def a_branch(tensor):
    inner = helper.make_graph(
        [helper.make_node("Identity", ["w"], ["y"])], "inner", [], [helper.make_empty_tensor_value_info("y")], [tensor]
    )
    return helper.make_node("If", ["c"], ["z"], then_branch=inner, else_branch=inner)


def wide_borders(model):
    first = model.graph.node[0]
    del first.attribute[:]
    first.attribute.append(helper.make_attribute("pads", [100_000] * 4))


def doubling(model):
    for number in range(40):
        source = f"d{number}" if number else "probability"
        model.graph.node.append(helper.make_node("Concat", [source, source], [f"d{number + 1}"], axis=1))


def broadcast(model):
    model.graph.initializer.extend([a_tensor("column", (1 << 16, 1)), a_tensor("row", (1, 1 << 16))])
    model.graph.node.append(helper.make_node("Add", ["column", "row"], ["w"]))


def another_output(model):
    last = model.graph.node[-1]
    last.output[0] = "before"
    model.graph.node.append(helper.make_node("Concat", ["before", "before"], ["probability"], axis=1))


def declared_size(model):
    next(tensor for tensor in model.graph.initializer if len(tensor.dims) > 1).dims[0] = LARGE


def with_node(node):
    return lambda model: model.graph.node.insert(0, node)


def with_shape(kind):
    def spoil(model):
        model.graph.initializer.append(helper.make_tensor("shape", onnx.TensorProto.INT64, [2], [LARGE, 1]))
        given = ["shape"] if kind == "ConstantOfShape" else ["probability", "shape"]
        model.graph.node.append(helper.make_node(kind, given, ["w"]))

    return spoil


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda model: external(model.graph.initializer[0]), "another file"),
        (with_node(helper.make_node("Constant", [], ["w"], value=external(a_tensor()))), "Constant"),
        (with_node(helper.make_node("Relu", ["patches"], ["w"], axis=external(a_tensor()))), "field 5"),
        (with_node(a_branch(external(a_tensor()))), "If"),
        (lambda model: model.functions.add(name="f", domain="d"), "field 25"),
        *((with_shape(kind), kind) for kind in ("ConstantOfShape", "Expand", "Tile", "Reshape")),
        (wide_borders, "takes more than"),
        (doubling, "takes more than"),
        (broadcast, "takes more than"),
        (another_output, "it gives float32"),
        (declared_size, "not that of its values"),
    ],
)
@pytest.mark.parametrize("kind", ["textures", "scan"])
def test_a_network_that_reaches_out_of_its_file_or_bounds_is_refused(tmp_path, kind, spoil, words):
    shipped = shipped_network("rating" if kind == "textures" else "scan", f"{kind}.onnx")
    path = tmp_path / "site" / "odd.onnx"
    path.parent.mkdir()
    (tmp_path / "secret.bin").write_bytes(b"1234")
    model = onnx.load_model_from_string(shipped)
    spoil(model)
    path.write_bytes(model.SerializeToString())
    load = TextureModel.load if kind == "textures" else ScanModel.load
    with pytest.raises(BadInputError, match=words) as caught:
        load(path)
    assert f"{path} is not an ONNX model that bumpymap runs" in str(caught.value)


def test_random_bytes_never_reach_onnx_runtime_as_a_crash(tmp_path):
    shipped = shipped_network("scan", "scan.onnx")
    rng, path = np.random.default_rng(0), tmp_path / "odd.onnx"
    for _ in range(150):
        content = bytearray(shipped)
        for place in rng.integers(0, 4096, 3):
            content[place] = rng.integers(256)
        path.write_bytes(content)
        try:
            assert isinstance(ScanModel.load(Path(path)), ScanModel)
        except BadInputError as error:
            assert "odd.onnx" in str(error)  # noqa: PT017 (most are refused)
