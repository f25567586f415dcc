"""Stacks of patches in the order of every file."""

from dataclasses import fields, replace

import numpy as np

from bumpymap.patches import join_stacks


def joined_in_order(stacks):
    """Put stacks together, north to south, then west to east."""
    whole = join_stacks(list(stacks))
    order = np.lexsort((whole.col, -whole.row))
    return replace(whole, **{f.name: getattr(whole, f.name)[order] for f in fields(whole) if f.name != "grid"})
