"""Surveys read into memory and measured block by block, for tables about all of their tiles."""

import numpy as np

from bumpymap.core import BadInputError, FeatureSettings, decide_ground
from bumpymap.patches import decks_as_ground, measure
from bumpymap.readers import PointStats, find_surveys, open_survey
from bumpytiles import TileBuckets


class MeasuredSurvey:
    """All points of surveys, 14 to 26 bytes each, by block of a grid."""

    def __init__(self, surveys, options, grid):
        self.buckets = TileBuckets(grid)
        for reader in (open_survey(path, options) for path in find_surveys(surveys)):
            stats = PointStats()
            for chunk in reader.chunks():
                batch = reader.convert(chunk, reader.fetch(chunk))
                stats = stats.merge(batch.stats)
                self.buckets.add_chunk(batch.grouped(grid))
            reader.verify(stats)
        if not len(self.buckets):
            raise BadInputError("no point is left: every point is withheld, noise or without return")
        flags = np.concatenate([self.buckets.flags(key) for key in self.buckets.keys()])  # noqa: SIM118 (no mapping)
        # For a single tile, the share of ground points replaces the count of tiles with ground points.
        self.ground_only = decide_ground("auto", 1, float(np.mean(flags[flags.any(axis=1), 1])))

    def measured(self, parts):
        """Measure the tiles of blocks; a dense block comes in several parts."""
        for points in parts:
            yield measure(decks_as_ground(points), FeatureSettings(), ground_only=self.ground_only)
