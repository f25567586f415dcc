"""Compiled loops of bumpymap, in the build that suits this processor: see `bumpytiles._loops`.

A loop of ``patches/standing.cpp`` is explained in ``patches/features.py``, which calls it.
"""

from typing import TYPE_CHECKING

from bumpytiles import loops_of

__all__ = ["loops"]

if TYPE_CHECKING:
    import bumpymap._loops_base as loops
else:
    loops = loops_of("bumpymap")
