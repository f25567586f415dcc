"""Which room may import what: HOUSE_STYLE's table, held by reading the source."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
VOCABULARY = {
    *("types", "config", "errors", "progress", "atomic", "interrupts", "json_text", "lock", "asked", "run_folder")
}
ROOMS = {
    # room: (rooms of bumpymap beside the vocabulary, heavy packages)
    "types": (set(), {"numpy", "pyproj", "bumpytiles"}),
    "config": (set(), set()),
    "errors": (set(), set()),
    "atomic": (set(), set()),
    "interrupts": (set(), set()),
    "progress": (set(), set()),
    "json_text": (set(), set()),
    "lock": (set(), set()),
    "asked": (set(), set()),
    "run_folder": (set(), set()),
    "toml_file": (set(), set()),
    "settings_file": ({"toml_file"}, set()),
    "calibration": (set(), set()),
    "textures": (set(), {"numpy", "scipy"}),
    "crs": ({"readers"}, {"laspy", "numpy", "pyproj"}),
    "ply_file": (set(), {"numpy"}),
    "readers": (
        {"crs", "ply_file"},
        {"bumpytiles", "fsspec", "lazrs", "numpy", "pypcd4", "pyproj"},
    ),
    "kernels": ({"shared_kernels"}, {"bumpytiles", "numpy"}),
    "shared_kernels": (set(), {"bumpytiles", "numpy"}),
    "ground": (set(), {"CSF", "bumpytiles", "numpy"}),
    "features": ({"kernels"}, {"bumpytiles", "numpy"}),
    "onnx_file": (set(), {"onnxruntime"}),
    "classify": ({"onnx_file", "textures"}, {"numpy"}),
    "cost": ({"calibration", "kernels"}, {"bumpytiles", "numpy"}),
    "products": (
        set(),
        {"bumpytiles", "numpy", "pyarrow", "pyogrio", "pyproj", "rasterio", "shapely"},
    ),
    "engine": ({"readers", "settings_file"}, {"bumpytiles", "numpy"}),
    "pipeline": (
        {
            "calibration",
            "classify",
            "cost",
            "engine",
            "features",
            "find_calibration",
            "ground",
            "products",
            "readers",
            "ride",
        },
        {"bumpytiles", "numpy"},
    ),
    "advice": (set(), {"bumpytiles"}),
    "find_calibration": ({"calibration", "vehicle"}, set()),
    "terrains": ({"textures"}, {"numpy", "scipy"}),
    "ride": ({"calibration"}, {"bumpytiles", "numpy"}),
    "vehicle": (
        {"calibration", "features", "ride", "terrains", "textures", "toml_file"},
        {"bumpytiles", "dartpy", "numpy"},
    ),
    "learn": ({"classify", "textures"}, {"matplotlib", "numpy", "onnx", "scipy", "torch"}),
    "learn_scan": ({"frames", "learn", "scan", "scan_world"}, {"numpy", "onnx", "torch"}),
    "evaluate": (
        {"calibration", "classify", "cost", "features", "readers", "ride", "terrains", "vehicle"},
        {"bumpytiles", "matplotlib", "numpy", "scipy"},
    ),
    "evaluate_scan": (
        {"evaluate", "frames", "learn_scan", "scan"},
        {"numpy", "scipy", "skimage", "sklearn"},
    ),
    "scan": ({"onnx_file", "shared_kernels"}, {"bumpytiles", "numpy", "skimage", "sklearn"}),
    "scan_world": (set(), {"numpy", "open3d"}),
    "scan_config": ({"frames", "scan"}, set()),
    "scan_methods": ({"scan", "scan_config"}, set()),
    "scan_products": ({"ply_file", "products", "scan"}, {"laspy", "lazrs", "numpy", "pyarrow", "pyproj", "rasterio"}),
    "scan_asked": ({"frames", "products", "readers", "scan", "scan_config", "scan_methods", "scan_products"}, set()),
    "scan_pipeline": (
        {
            "crs",
            "find_calibration",
            "frames",
            "pipeline",
            "products",
            "scan",
            "scan_asked",
            "scan_config",
            "scan_methods",
            "scan_products",
        },
        {"numpy", "pyproj"},
    ),
    "frames": ({"readers", "scan"}, {"numpy", "pypcd4"}),
    "sample": ({"ply_file"}, {"bumpytiles", "laspy", "numpy", "pyproj"}),
}
HEAVY = {
    "CSF",
    "bumpytiles", "dartpy", "dask", "distributed", "geopandas", "laspy", "lazrs", "llvmlite", "matplotlib", "numba",
    "numpy", "onnx", "onnxruntime", "open3d", "pandas", "pyarrow", "pyogrio", "pypcd4", "pyproj", "rasterio",
    "scipy", "shapely", "skimage", "sklearn", "torch",
}  # fmt: skip


def sources(room):
    single = ROOT / "bumpymap" / f"{room}.py"
    return [single] if single.exists() else sorted((ROOT / "bumpymap" / room).rglob("*.py"))


def imported(file):
    """Dotted names that a file imports, anywhere in it."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_what_its_row_allows(room):
    rooms, heavy = ROOMS[room]
    files = sources(room)
    assert files, f"room {room} is gone: take it out of the table"
    for file in files:
        for name in imported(file):
            top, _, rest = name.partition(".")
            if top == "bumpymap" and rest:
                other = rest.split(".")[0]
                if other in ROOMS or other == "cli":
                    assert other in rooms | VOCABULARY | {room}, f"{file.name} imports room {other}"
            elif top in HEAVY:
                assert top in heavy, f"{file.name} imports {top}"


def test_one_module_imports_onnx_runtime():
    """It switches the telemetry off first; whoever imports ONNX Runtime past it switches it on."""
    folders = ("bumpymap", "tiles", "benchmarks", "docs", "tests/bumpymap", "tests/tiles")
    files = [file for folder in folders for file in (ROOT / folder).rglob("*.py")]
    importing = {file for file in files if "onnxruntime" in {name.split(".")[0] for name in imported(file)}}
    assert importing == {ROOT / "bumpymap" / "onnx_file.py"}


def test_json_of_others_is_parsed_to_a_bounded_depth():
    for file in (ROOT / "bumpymap").rglob("*.py"):
        if file.stem != "json_text":
            calls = [
                node for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)
            ]
            own = [node for node in calls if ast.unparse(node.func) in {"json.loads", "json.load"}]
            foreign = [node for node in own if not ast.unparse(node.args[0]).startswith("json.dumps")]
            assert not foreign, f"{file}: use parse_json"


def test_every_room_has_a_row():
    rooms = {path.stem for path in (ROOT / "bumpymap").glob("*.py")} | {
        path.parent.name for path in (ROOT / "bumpymap").glob("*/__init__.py")
    }
    assert rooms - {"__init__", "__main__", "cli"} == set(ROOMS)


def test_the_engine_does_not_know_bumpymap():
    for file in (ROOT / "tiles" / "bumpytiles").glob("*.py"):
        assert not [name for name in imported(file) if name.split(".")[0] == "bumpymap"]


def test_the_main_job_loads_no_workshop():
    code = "import bumpymap.survey.pipeline, bumpymap.cli.map_command, sys; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"torch", "dask", "open3d", "dartpy", "sklearn", "geopandas", "pandas", "matplotlib"} & set(loaded)


def test_help_loads_nothing_heavy():
    code = "import sys; from bumpymap.cli import main; main(['--help'], standalone_mode=False); print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "map" in out
    assert not HEAVY & set(out)


def test_a_run_with_kept_kernels_loads_neither_the_compiler_nor_pandas(tmp_path):
    survey = str(ROOT / "sample_data" / "quarry.laz")
    code = "import sys; from bumpymap.cli import main; main(sys.argv[1:], standalone_mode=False); print(*sys.modules)"
    for run in ("first", "second"):  # the first may have to compile
        command = [sys.executable, "-c", code, "map", survey, "--out", str(tmp_path / run)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert {"llvmlite", "pyarrow", "pyogrio"} <= set(loaded)
    assert not {"numba", "pandas", "geopandas"} & set(loaded)
