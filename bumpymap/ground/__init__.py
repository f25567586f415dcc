"""Which points are ground, where the survey does not say: points of a block in, a mark for each of them out."""

from bumpymap.ground.cloth import filter_version, mark_ground, require_filter, rest_filter

__all__ = ["filter_version", "mark_ground", "require_filter", "rest_filter"]
