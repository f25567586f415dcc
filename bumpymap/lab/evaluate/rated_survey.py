"""The map under evaluation: the tiles of a survey, measured block by block, and their ratings for a vehicle."""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from itertools import count
from os.path import lexists
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    BadInputError,
    CostMap,
    FeatureSettings,
    Georeference,
    Ground,
    OutputError,
    PatchStack,
    Progress,
    TextureMap,
    UsageError,
    common_georeference,
    decide_ground,
    remove_path,
)
from bumpymap.patches import decks_as_ground, join_stacks, measure
from bumpymap.rating import Calibration, RideModel, TextureModel, Vehicle, classify, rate
from bumpymap.readers import Location, PointStats, ReadOptions, SurveyReader, find_surveys, open_survey
from bumpytiles import BLOCK_TILES, Grid, MemoryLimits, TileBuckets, TilePoints

Rate = Callable[[PatchStack, TextureMap, Georeference], CostMap]
_PLACELESS = Georeference(None)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Results of one rating for n tiles, with the fields of `CostMap`."""

    class_id: NDArray[np.uint8]
    c_r: NDArray[np.float64]
    c_r_low: NDArray[np.float64]
    c_r_high: NDArray[np.float64]
    p_fail: NDArray[np.float64]
    confidence: NDArray[np.float64]

    @classmethod
    def of(cls, cost_map: CostMap) -> "Verdict":
        """Copy the fields from a cost map."""
        floats = [getattr(cost_map, f.name).astype(np.float64) for f in fields(cls)[1:]]
        return cls(cost_map.class_id, *floats)

    @classmethod
    def join(cls, parts: "Sequence[Verdict]") -> "Verdict":
        """Concatenate the tiles of several verdicts."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> "Verdict":
        """Select tiles."""
        return Verdict(*(getattr(self, f.name)[rows] for f in fields(self)))


@dataclass(frozen=True)
class Subject:
    """A calibrated vehicle and its ratings."""

    calibration: Calibration
    profile: Vehicle
    ratings: Mapping[str, Rate]
    """Name -> rating: ``ride``, ``table``. Patches are chosen by the first."""
    textures: TextureModel

    @classmethod
    def of(cls, calibration: Calibration, textures: TextureModel) -> "Subject":
        """Make the ratings of a calibration; one without a ride model has its table alone.

        Raises
        ------
        UsageError
            The texture network is for other tiles.
        """
        textures.require_grid(calibration.tile_size, calibration.pixels)
        calibration = calibration.without_floor()  # it is held against simulated drives, which have none
        profile = Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}")

        def by_table(patches: PatchStack, seen: TextureMap, place: Georeference) -> CostMap:
            return rate(patches, seen, calibration, place)

        return cls(calibration, profile, {"ride": RideModel(calibration).rate, "table": by_table}, textures)

    @property
    def name(self) -> str:
        """Name of the vehicle."""
        return str(self.calibration.vehicle["name"])

    @property
    def key(self) -> str:
        """Name of the vehicle and eight digits of the hash of its profile, which determines its drives."""
        text = json.dumps(self.calibration.vehicle, sort_keys=True)
        return f"{self.name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"

    def judge(self, patches: PatchStack) -> dict[str, Verdict]:
        """Rate tiles with all ratings."""
        seen = classify(patches, self.textures)
        return {name: Verdict.of(rating(patches, seen, _PLACELESS)) for name, rating in self.ratings.items()}


MOST_BYTES = 260_000_000
"""Memory for points, bytes; those beyond it are stored on disk."""
BLOCK_POINTS = 10_000_000

Ints = NDArray[np.int64]


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

    def patches(self, col: Ints, row: Ints) -> PatchStack:
        """Measure the given tiles (at least one, all with points), in the given order."""
        wanted = {tile: i for i, tile in enumerate(zip(col.tolist(), row.tolist(), strict=True))}
        stacks = []
        for key in sorted({(row // BLOCK_TILES, col // BLOCK_TILES) for col, row in wanted}):
            for stack in self.measured(self.buckets.block(key)):
                tiles = zip(stack.col.tolist(), stack.row.tolist(), strict=True)
                stacks.append(take_tiles(stack, np.array([tile in wanted for tile in tiles])))
        joined = join_stacks(stacks)
        place = {tile: i for i, tile in enumerate(zip(joined.col.tolist(), joined.row.tolist(), strict=True))}
        return take_tiles(joined, np.array([place[tile] for tile in wanted]))


def take_tiles(patches: PatchStack, rows: NDArray[np.integer] | NDArray[np.bool_]) -> PatchStack:
    """Select tiles of a stack."""
    return PatchStack(patches.grid, *(getattr(patches, f.name)[rows] for f in fields(PatchStack) if f.name != "grid"))


@contextmanager
def load_survey(
    readers: Sequence[SurveyReader],
    ground: Ground,
    grid: Grid,
    features: FeatureSettings,
    folder: Path,
    progress: Progress,
) -> Iterator[MeasuredSurvey]:
    """Read surveys in a context manager; points that exceed the memory limit are in ``folder`` until its end.

    Raises
    ------
    BadInputError
        A file is damaged, or no point is left.
    OutputError
        The disk is full.
    """
    if ground == "csf":
        raise UsageError("`ground='csf'` is supported by map only. Use `ground='all'` or `ground='class'` here")
    try:
        with _scratch(folder / ".points") as scratch:
            buckets = TileBuckets(grid, MemoryLimits(MOST_BYTES, BLOCK_POINTS, scratch))
            progress.start("reading points", sum(reader.info.point_count for reader in readers))
            number = count()
            for reader in readers:
                stats = PointStats()
                for chunk in reader.chunks():
                    batch = reader.convert(chunk, reader.fetch(chunk))
                    stats = stats.merge(batch.stats)
                    buckets.add_chunk(batch.grouped(grid), next(number))
                    if buckets.is_full:
                        buckets.spill()
                    progress.advance(chunk.points)
                reader.verify(stats)
            if not len(buckets):
                raise BadInputError("no point is left: every point is withheld, noise or without return")
            # For a single tile, the share of ground points replaces the count of tiles with ground points.
            ground_only = decide_ground(ground, 1, 0.0 if ground == "all" else buckets.flagged_share())
            yield MeasuredSurvey(buckets, ground_only, features)
    except OSError as error:
        raise OutputError(f"cannot write temporary points to {folder}: {error}. Choose another `out`") from error


@contextmanager
def _scratch(folder: Path) -> Iterator[Path]:
    """Make an empty folder; delete leftovers of a killed run."""
    if lexists(folder):
        remove_path(folder)
    folder.mkdir(mode=0o700)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
