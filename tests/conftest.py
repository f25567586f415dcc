import os
import sys
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings

from bumpymap.core.errors import UsageError
from bumpymap.lab import load_open3d

# No test may depend on a clock; in CI the same examples are tried every time.
settings.register_profile("bumpymap", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("bumpymap")

sys.path.append(str(Path(__file__).parent / "helpers"))  # modules that several rooms' tests share


@cache
def _why_without_open3d():
    try:
        load_open3d("this test")
    except UsageError as error:
        return str(error)
    return None


def pytest_runtest_setup(item):
    """Skip a test that is marked with ``open3d`` where it cannot be loaded, and say why."""
    if item.get_closest_marker("open3d") and (reason := _why_without_open3d()):
        pytest.skip(reason)
