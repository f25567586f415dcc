"""Surveys read into memory and measured block by block, for tables about all of their tiles."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from bumpymap.core import (
    BadInputError,
    FeatureSettings,
    Ground,
    PatchStack,
    Progress,
    UsageError,
    common_georeference,
    decide_ground,
)
from bumpymap.patches import decks_as_ground, measure
from bumpymap.readers import Location, PointStats, ReadOptions, SurveyReader, find_surveys, open_survey
from bumpytiles import Grid, TileBuckets, TilePoints


def open_readers(surveys: Sequence[Location], options: ReadOptions, *, local: bool) -> list[SurveyReader]:
    """Open survey files and check that they share one CRS.

    Raises
    ------
    BadInputError
        A file cannot be read, files have different CRS, or there is no CRS and ``local`` is False.
    """
    readers = [open_survey(path, options) for path in find_surveys(surveys)]
    if common_georeference([reader.info for reader in readers]).crs is None and not local:
        raise BadInputError(
            f"{readers[0].info.path} has no CRS, so the unit of its coordinates is unknown. Pass `crs='EPSG:CODE'`, "
            "or `local=True` if they are metres"
        )
    return readers


@dataclass(frozen=True, slots=True)
class MeasuredSurvey:
    """All points of a survey, by block."""

    buckets: TileBuckets
    ground_only: bool
    """True if only ground points are measured."""
    features: FeatureSettings

    def measured(self, parts: Iterable[TilePoints]) -> Iterator[PatchStack]:
        """Measure the tiles of blocks; a dense block comes in several parts."""
        for points in parts:
            yield measure(decks_as_ground(points), self.features, ground_only=self.ground_only)


def load_survey(
    readers: Sequence[SurveyReader], ground: Ground, grid: Grid, features: FeatureSettings, progress: Progress
) -> MeasuredSurvey:
    """Read surveys into memory, 14 to 26 bytes a point.

    Raises
    ------
    BadInputError
        A file is damaged, or no point is left.
    UsageError
        The ground is that of a cloth.
    """
    if ground == "csf":
        raise UsageError("`ground='csf'` is supported by map only. Use `ground='all'` or `ground='class'` here")
    buckets = TileBuckets(grid)
    progress.start("reading points", sum(reader.info.point_count for reader in readers))
    for reader in readers:
        stats = PointStats()
        for chunk in reader.chunks():
            batch = reader.convert(chunk, reader.fetch(chunk))
            stats = stats.merge(batch.stats)
            buckets.add_chunk(batch.grouped(grid))
            progress.advance(chunk.points)
        reader.verify(stats)
    if not len(buckets):
        raise BadInputError("no point is left: every point is withheld, noise or without return")
    # For a single tile, the share of ground points replaces the count of tiles with ground points.
    ground_only = decide_ground(ground, 1, 0.0 if ground == "all" else buckets.flagged_share())
    return MeasuredSurvey(buckets, ground_only, features)
