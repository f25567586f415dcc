"""A fresh machine has open3d without the libraries of the system that it needs: its tests skip and say why."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

TESTS = Path(__file__).parent
BROKEN = 'raise ImportError("libusb-1.0.so.0: cannot open shared object file")'


def test_tests_of_open3d_skip_with_the_reason_and_no_module_fails_to_collect(tmp_path):
    (tmp_path / "open3d.py").write_text(BROKEN)
    paths = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    named = [path for path in TESTS.rglob("test_*.py") if re.search(r"mark\.open3d\b", path.read_text("utf-8"))]
    named = [str(path) for path in named if path != Path(__file__)]
    assert named
    command = [sys.executable, "-m", "pytest", "-q", "-m", "open3d", "-p", "no:cacheprovider", *named]
    done = subprocess.run(
        command,
        env=os.environ | {"PYTHONPATH": paths},
        cwd=TESTS.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert re.search(r"^\d+ skipped", done.stdout.splitlines()[-1]), done.stdout
    assert "apt-get install libusb-1.0-0 libegl1 libgl1 libx11-6" in done.stdout


def test_no_test_has_a_way_of_its_own_to_skip_open3d():
    own = re.compile(r"importorskip\(\s*[\"']open3d|import_module\(\s*[\"']open3d")
    assert [
        path for path in TESTS.rglob("*.py") if path != Path(__file__) and own.search(path.read_text("utf-8"))
    ] == []
