"""Packages whose names are loaded late: each name can be had, and nothing heavy is loaded early."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import bumpymap

ROOMS = ("evaluate", "evaluate_scan", "learn", "learn_scan", "vehicle")


@pytest.mark.parametrize("room", ROOMS)
def test_every_public_name_can_be_had_when_all_modules_are_loaded(room):
    if room.startswith("learn"):
        pytest.importorskip("torch", reason="torch comes with the extra 'learn'")
        pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")
    package = import_module(f"bumpymap.{room}")
    for file in (Path(bumpymap.__file__).parent / room).glob("[a-z]*.py"):
        import_module(f"bumpymap.{room}.{file.stem}")
    for name in package.__all__:
        assert not isinstance(getattr(package, name), ModuleType), f"{name} is hidden by the module of that name"
    with pytest.raises(AttributeError, match=f"module 'bumpymap.{room}' has no attribute 'nothing'"):
        package.nothing  # noqa: B018 - asking for it is the test


def test_the_packages_themselves_load_nothing_heavy():
    code = f"import sys; {'; '.join(f'import bumpymap.{room}' for room in ROOMS)}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "bumpymap.lab.simulate" in loaded
    assert not {"torch", "onnx", "open3d", "matplotlib", "dartpy", "numpy", "scipy", "numba"} & set(loaded)


def test_profiles_are_read_and_begun_without_the_simulation():
    program = "from bumpymap.lab.simulate import load_profile, write_blank; load_profile('car')"
    code = f"import sys; {program}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    own = {name.rpartition(".")[2] for name in loaded if name.startswith("bumpymap.lab.simulate.")}
    assert own == {"blank", "faults", "keys", "profile"}
