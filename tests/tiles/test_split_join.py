"""Joining the tiles of several blocks."""

import numpy as np

from bumpytiles import Grid, TileBuckets, join_tiles


def test_joined_tiles_hold_the_points_of_their_parts():
    rng = np.random.default_rng(4)
    buckets = TileBuckets(Grid())
    spread = rng.uniform(0.0, 400.0, (3, 500))
    buckets.add(*spread, np.arange(500) % 3 == 0)
    parts = list(buckets.blocks())
    whole = join_tiles(parts)
    assert len(parts) > 10
    tile = 0
    for part in parts:
        for number in range(len(part.col)):
            ours, theirs = slice(*whole.starts[tile : tile + 2]), slice(*part.starts[number : number + 2])
            assert (whole.col[tile], whole.row[tile]) == (part.col[number], part.row[number])
            for name in ("easting", "northing", "upward", "flag"):
                np.testing.assert_array_equal(getattr(whole, name)[ours], getattr(part, name)[theirs])
            tile += 1
    assert tile == len(whole.col)
    assert whole.starts[-1] == 500
