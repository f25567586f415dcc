"""Stacks of patches in the order of every file, and blocks of points."""

from dataclasses import fields, replace

import numpy as np

from bumpymap.patches import join_stacks
from bumpytiles import Grid, TileBuckets


def joined_in_order(stacks):
    """Put stacks together, north to south, then west to east."""
    whole = join_stacks(list(stacks))
    order = np.lexsort((whole.col, -whole.row))
    return replace(whole, **{f.name: getattr(whole, f.name)[order] for f in fields(whole) if f.name != "grid"})


def block_of(x, y, z, flag=None):
    """The last block of points on tiles of 3 m."""
    buckets = TileBuckets(Grid())
    buckets.add(*(np.asarray(axis, float) for axis in (x, y, z)), np.zeros(len(x), bool) if flag is None else flag)
    return list(buckets.blocks())[-1]
