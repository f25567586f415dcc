import os
import signal
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from bumpymap.core.config import FeatureSettings
from bumpymap.patches.features import measure
from bumpytiles import Grid, TileBuckets

# No test may depend on a clock; in CI the same examples are tried every time.
settings.register_profile("bumpymap", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("bumpymap")

# Workers of pytest-xdist, which share the cores, inherit it: threads of OpenBLAS that have nothing to do wait busily.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A suite that runs in the background (`make test &`, nohup) ignores Ctrl-C, and so would every command that it starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Modules that several rooms' tests share, made-up ground, and damaged files.
sys.path += [str(Path(__file__).parent / folder) for folder in ("helpers", "worlds", "hostile", "fuzz")]


NEEDS = {
    "chromium": (["chromium", "--version"], "chromium"),
    # Even where it is installed, system libraries that it needs may be missing.
    "open3d": ([sys.executable, "-c", "import open3d"], "libusb-1.0-0 libegl1 libgl1 libx11-6"),
    # QGIS has a Python of its own: that of the system.
    "qgis": (["/usr/bin/python3", "-c", "import qgis.core, qgis.gui"], "python3-qgis"),
    # Only root can make networks and mounts of its own.
    "namespaces": (["unshare", "--mount", "--net", "true"], "util-linux"),
}
"""What tests with a mark need: a command that fails where it is missing, and Debian's packages."""


@cache
def _why_without(mark):
    """Say why a test with a mark cannot run here; nothing, if it can."""
    command, packages = NEEDS[mark]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        return f"no {mark} here (Debian: apt-get install {packages}): {error}"
    said = done.stderr.strip().splitlines()[-1:]
    return f"no {mark} here (Debian: apt-get install {packages}): {said}" if done.returncode else ""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Leave tests that need real data, open3d, QGIS, a browser or root for later; what comes later is slow too."""
    for item in items:
        if any(map(item.get_closest_marker, ("realdata", "open3d", "qgis", "chromium", "namespaces"))):
            item.add_marker(pytest.mark.later)
        if item.get_closest_marker("later"):
            item.add_marker(pytest.mark.slow)


def pytest_runtest_setup(item):
    """Skip a test that is marked with what is missing here, and say why."""
    for mark in NEEDS:
        if item.get_closest_marker(mark) and (reason := _why_without(mark)):
            pytest.skip(reason)


@pytest.fixture(scope="session", autouse=True)
def fast_disk():
    """No file of a test is to outlive a power cut, so none is waited for until it is on the disk."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


SHARED = Path(__file__).resolve().parents[1].parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data():
    """Folder of the real surveys and scans; the test is skipped where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("the real surveys (../shared/data) are not here")
    return SHARED


@pytest.fixture(scope="module")
def without_views():
    """Maps of a module are made without pages, styles and projects, which take more time than their layers."""
    from small_surveys import no_views

    with no_views():
        yield


@pytest.fixture
def limit_points(monkeypatch):
    """Function that limits the points of a chunk, of a block, and of those that wait in memory."""
    from bumpymap.survey import Budget

    def limit(**most):
        for name, points in most.items():
            monkeypatch.setattr(Budget, f"{name}_points", points)

    return limit


@pytest.fixture
def batches_here():
    """Batches of a test map their surveys in its process."""
    from small_surveys import batches_here

    with batches_here():
        yield


def measure_points(x, y, z, flag=None, *, grid=None, settings=None, ground_only=False):
    """PatchStack of loose points."""
    from cost_maps import joined_in_order

    buckets = TileBuckets(grid or Grid())
    x, y, z = (np.asarray(column, float) for column in (x, y, z))
    buckets.add(x, y, z, np.zeros(len(x), bool) if flag is None else flag)
    blocks = list(buckets.blocks())
    return joined_in_order(measure(block, settings or FeatureSettings(), ground_only=ground_only) for block in blocks)


@pytest.fixture(name="measure_points", scope="session")
def measure_points_fixture():
    return measure_points


@pytest.fixture(scope="session")
def cost_map():
    from cost_maps import make_field

    return make_field(40, 30)
