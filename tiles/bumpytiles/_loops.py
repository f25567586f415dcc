"""Compiled loops, in the build that suits this processor; see ``tiles/CMakeLists.txt``.

Each package has two builds of one source: ``_loops_base`` for every processor, and on x86-64 ``_loops_v3`` for those
with AVX2 (since about 2013). Both give the same bits. BUMPYMAP_LOOPS=base in the environment takes the first.
"""

import os
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

__all__ = ["loops", "loops_of"]


def loops_of(package: str) -> ModuleType:
    """Return the module of compiled loops of a package."""
    every = import_module("bumpytiles._loops_base")
    fast = every.runs_v3() and os.environ.get("BUMPYMAP_LOOPS") != "base"
    return import_module(f"{package}._loops_v3" if fast else f"{package}._loops_base")


if TYPE_CHECKING:
    import bumpytiles._loops_base as loops
else:
    loops = loops_of("bumpytiles")
