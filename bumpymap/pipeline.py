"""The main job, step by step: surveys in, rated tiles and their files out. No arithmetic here, only the order."""

import logging
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from bumpymap.calibration import Calibration
from bumpymap.classify import TextureModel, classify
from bumpymap.config import MapConfig
from bumpymap.cost import rate, rate_as_paper
from bumpymap.errors import BadInputError
from bumpymap.features import join_stacks, measure
from bumpymap.products import MapSummary, check_extent, check_folder, write_products
from bumpymap.progress import Progress, SilentProgress, Stopwatch
from bumpymap.readers import ReadOptions, SurveyReader, common_georeference, find_surveys, open_survey
from bumpymap.types import CostMosaic, Georeference, PatchStack
from bumpytiles import Grid, TileBuckets, group_points, run_blocks

__all__ = ["MapResult", "map_surveys"]

_log = logging.getLogger(__name__)

_CLASSIFIED_SHARE = 0.5
"""``ground = "auto"`` measures class 2 alone where more than this share of the tiles has such points."""


@dataclass(frozen=True, slots=True)
class MapResult:
    """What a run did."""

    files: tuple[Path, ...]
    """Written, in the order of writing."""
    summary: MapSummary
    """The rated tiles in a few numbers."""
    points: int
    """Points that count: read, and neither withheld nor noise; duplicates are still among them."""
    ground_only: bool
    """Only points of class 2 were measured."""
    skipped: dict[str, str]
    """Inputs that could not be read, with the message (``skip_bad``)."""
    seconds: dict[str, float]
    """Wall time by stage."""


@dataclass(slots=True)
class _Inputs:
    """The readers of a run, and what became of each."""

    readers: list[SurveyReader]
    georeference: Georeference
    skipped: dict[str, str]


def map_surveys(config: MapConfig, progress: Progress | None = None) -> MapResult:
    """Map surveys: read, cut into tiles, measure, classify, rate, write.

    Raises
    ------
    BumpymapError
        Anything a user can cause; no file is left half-written.
    """
    fresh = not config.out.exists()
    try:
        return _map(config, progress or SilentProgress())
    except BaseException:
        if fresh:
            with suppress(OSError):  # goes away where nothing was written to it
                config.out.rmdir()
        raise


def _map(config: MapConfig, told: Progress) -> MapResult:
    clock = Stopwatch()
    grid = Grid(config.tile_size, config.pixels)
    with clock.stage("prepare"):
        check_folder(config.out, overwrite=config.overwrite)
        calibration = _calibration(config)
        model = TextureModel.load(config.model) if config.model else TextureModel.shipped()
        model.require_grid(config.tile_size, config.pixels)
        calibration.require_grid(config.tile_size, config.pixels)
        inputs = _open(config)
    with clock.stage("read"):
        buckets = _read(inputs, grid, config, told)
        check_extent(grid, buckets.window())
        points = sum(reader.info.point_count - sum(reader.dropped.values()) for reader in inputs.readers)
        ground_only = _ground_only(config, buckets)
    with clock.stage("measure"):
        patches = _measure(buckets, config, told, ground_only=ground_only)
    with clock.stage("rate"):
        told.start("rating tiles", None)
        rating = rate_as_paper if config.compat == "paper" else rate
        cost_map = rating(patches, classify(patches, model), calibration, inputs.georeference)
    told.start("writing layers", None)
    manifest = {
        "inputs": [_input_record(reader) for reader in inputs.readers],
        "skipped": inputs.skipped,
        "settings": config,
        "ground_only": ground_only,
        "points": points,
        "model": model.id,
        "calibration": {
            "id": calibration.id,
            "vehicle": calibration.vehicle["name"],
            "class_limits": calibration.class_limits,
        },
        "seconds": clock.seconds,
    }
    with clock.stage("write"):
        mosaic = CostMosaic.of(cost_map)
        files, summary = write_products(mosaic, config.out, local=config.local, manifest=manifest)
    return MapResult(tuple(files), summary, points, ground_only, inputs.skipped, clock.seconds)


def _calibration(config: MapConfig) -> Calibration:
    return Calibration.load(config.calibration) if config.calibration else Calibration.shipped(config.vehicle)


def _open(config: MapConfig) -> _Inputs:
    """Open every input; settle on one CRS before the long work begins."""
    options = ReadOptions(crs=config.crs, z_unit=config.z_unit, trust_points=config.trust_points)
    readers: list[SurveyReader] = []
    skipped: dict[str, str] = {}
    for path in find_surveys(config.surveys):
        try:
            readers.append(open_survey(path, options))
        except BadInputError as error:
            _skip(path, error, skipped, config)
    if not readers:
        raise BadInputError("none of the inputs could be read:\n" + "\n".join(skipped.values()))
    georeference = common_georeference([reader.info for reader in readers])
    if georeference.crs is not None and config.local:
        _log.warning("--local is not needed: the survey has a CRS (%s)", georeference.crs.name)
    if georeference.crs is None and not config.local:
        raise BadInputError(
            f"{readers[0].info.path} has no CRS, so its place on Earth is unknown. Pass --crs EPSG:CODE, "
            "or --local to map it in its own coordinates (rasters without a CRS, cost.geojson in local metres)"
        )
    return _Inputs(readers, georeference, skipped)


def _skip(path: Path, error: BadInputError, skipped: dict[str, str], config: MapConfig) -> None:
    """Note a bad input and go on, or raise."""
    if not config.skip_bad:
        raise error
    _log.warning("skipped %s: %s", path, error)
    skipped[str(path)] = str(error)


def _read(inputs: _Inputs, grid: Grid, config: MapConfig, told: Progress) -> TileBuckets:
    """Sort the points of every input into blocks; a file that breaks in the middle leaves none of its points."""
    told.start("reading points", sum(reader.info.point_count for reader in inputs.readers))
    buckets = TileBuckets(grid)
    whole: list[SurveyReader] = []
    for reader in inputs.readers:
        staged = []
        try:
            for chunk in reader.chunks():
                staged.append(group_points(grid, chunk.easting, chunk.northing, chunk.upward, chunk.is_ground))
                told.advance(len(chunk.easting))
        except BadInputError as error:
            _skip(reader.info.path, error, inputs.skipped, config)
            continue
        for run in staged:
            buckets.take(run)
        whole.append(reader)
    inputs.readers = whole
    if not len(buckets):
        reasons = "\n".join(inputs.skipped.values()) or "every point is withheld or marked as noise"
        raise BadInputError(f"no point is left to map: {reasons}")
    return buckets


def _ground_only(config: MapConfig, buckets: TileBuckets) -> bool:
    """Decide which points count, for the whole survey (DESIGN 3)."""
    if config.ground == "all":
        return False
    share = buckets.flagged_share()
    if config.ground == "class" and share == 0.0:
        raise BadInputError("--ground class: no point of the survey has class 2 (ground). Use --ground all")
    return config.ground == "class" or share > _CLASSIFIED_SHARE


def _measure(buckets: TileBuckets, config: MapConfig, told: Progress, *, ground_only: bool) -> PatchStack:
    told.start("measuring tiles", len(buckets))
    work = partial(measure, settings=config.features, ground_only=ground_only)
    stacks = []
    for stack in run_blocks(work, buckets.blocks(), config.workers):
        stacks.append(stack)
        told.advance(1)
    return join_stacks(stacks)


def _input_record(reader: SurveyReader) -> dict[str, Any]:
    info = reader.info
    return {
        "path": info.path,
        "format": info.format,
        "points": info.point_count,
        "dropped": reader.dropped,
        "notes": info.notes,
    }
