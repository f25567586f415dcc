"""The main job, step by step: surveys in, rated tiles and their files out. No arithmetic here, only the order."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from bumpymap.core import (
    BadInputError,
    Compat,
    CostTable,
    CsfSettings,
    FeatureSettings,
    Georeference,
    Ground,
    MapConfig,
    Progress,
    SilentProgress,
    Stopwatch,
    check_interrupted,
    common_georeference,
    differences,
    flat_settings,
    locked,
    remove_empty_on_error,
    same_content,
    spec_of_manifest,
    tile_columns,
)
from bumpymap.layers import (
    MANIFEST_NAME,
    PRODUCT_NAMES,
    MapSummary,
    check_extent,
    check_folder,
    is_complete,
    refuse_replacing,
    software_versions,
    verified_record,
    write_products,
)
from bumpymap.patches import close_filter, filter_version, mark_ground, measure, require_filter
from bumpymap.rating import Calibration, RideModel, TextureModel, classify, find_calibration, rate, rate_as_paper
from bumpymap.readers import ReadOptions, SurveyReader, find_surveys, identity, open_survey
from bumpymap.survey.engine import (
    ADVICE,
    BlockWork,
    Budget,
    ClusterExecutor,
    Executor,
    Inputs,
    LocalExecutor,
    MeasuredTiles,
    WorkerPool,
    Workspace,
    connect,
    memory_bytes,
    run_engine,
)
from bumpytiles import Grid, TilePoints, TileWindow

__all__ = ["MapResult", "map_surveys"]

_log = logging.getLogger(__name__)

_NAMED = 5
"""Files that a message names."""
_NO_SAY = {
    "surveys",
    "out",
    "resume",
    "overwrite",
    "threads",
    "memory",
    "scratch",
    "workers",
    "scheduler",
    "tls_config",
}
"""Settings without a say in the numbers: a run may go on with others."""


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
    """Only ground was measured: points of class 2, or those that the cloth found (``ground = "csf"``)."""
    skipped: dict[str, str]
    """Inputs that could not be read, with the message (``skip_bad``)."""
    seconds: dict[str, float]
    """Wall time by stage."""
    already_done: bool = False
    """An earlier run made the same of the same inputs; nothing was written, and all of this is what it noted."""


@dataclass(slots=True)
class _Inputs:
    """The readers of a run, and what became of each."""

    readers: list[SurveyReader]
    georeference: Georeference
    skipped: dict[str, str]


@dataclass(frozen=True, slots=True)
class _Rating:
    """What turns the points of tiles into rated tiles; travels to other threads and machines."""

    features: FeatureSettings
    csf: CsfSettings | None
    """None: ground is what the survey says."""
    compat: Compat
    model: TextureModel
    calibration: Calibration
    ride: RideModel | None
    """None: rate by texture and relief."""
    georeference: Georeference

    def __call__(self, points: TilePoints, ground_only: bool) -> dict[str, NDArray[Any]]:
        """Find the ground, measure, classify, rate; columns of `tile_columns`."""
        if self.csf is not None:
            points = replace(points, flag=mark_ground(points, self.csf))
        patches = measure(points, self.features, ground_only=ground_only)
        textures = classify(patches, self.model)
        if self.ride is not None:
            return self.ride.rate(patches, textures, self.georeference).columns()
        rating = rate_as_paper if self.compat == "paper" else rate
        return rating(patches, textures, self.calibration, self.georeference).columns()


def map_surveys(config: MapConfig, progress: Progress | None = None) -> MapResult:
    """Map surveys: read, cut into tiles, measure, classify, rate, write.

    Raises
    ------
    BumpymapError
        Anything a user can cause; no file is left half-written.
    """
    try:
        with remove_empty_on_error(config.out), locked(config.out):
            return _map(config, progress or SilentProgress())
    finally:
        close_filter()


def _map(config: MapConfig, progress: Progress) -> MapResult:
    clock = Stopwatch()
    grid = Grid(config.tile_size, config.pixels)
    budget = Budget(memory_bytes(config.memory), config.threads)
    with clock.stage("prepare"):
        is_there = _check_out(config)
        csf = config.csf if config.ground == "csf" else None
        if csf is not None:
            require_filter(csf, grid)
            _log.warning(
                "`ground='csf'` removes everything that stands more than %g m above the ground, boulders and posts as "
                "well as trees. The layers show how rough the ground is, not whether it is free of obstacles",
                csf.class_threshold,
            )
        calibration = find_calibration(config.vehicle, config.calibration)
        model = TextureModel.load(config.model) if config.model else TextureModel.shipped()
        model.require_grid(config.tile_size, config.pixels)
        calibration.require_grid(config.tile_size, config.pixels)
        ride = RideModel(calibration) if config.rating == "ride" and config.compat == "none" else None
        inputs = _open(config)
        run_spec = _asked(config, inputs, budget, model, calibration)
    if is_there:
        return _done_before(config, run_spec)
    rating = _Rating(config.features, csf, config.compat, model, calibration, ride, inputs.georeference)
    work = BlockWork(grid, tile_columns(grid.pixels), rating, config.ground)
    # Workers first: a failure to get them must not cost what an earlier run has finished.
    with (
        connect(config.scheduler, config.workers, config.threads, config.tls_config) as pool,
        Workspace.opened(config.out, config.scratch, run_spec, resume=config.resume, advice=_advice(config)) as space,
    ):
        executor = _executor(config, work, space, budget, progress, pool)
        skip, check = partial(_skip, inputs, config), partial(_check_span, inputs, grid)
        survey_files = Inputs(inputs.readers, skip, check, config.skip_bad)
        done = run_engine(survey_files, work, space, budget, executor, progress, clock)
        table = CostTable(inputs.georeference, calibration.cost_rule, done.table)
        manifest = _manifest(config, inputs, run_spec, done, model, calibration, clock)
        with clock.stage("write"):
            files, summary = write_products(table, config.out, local=config.local, manifest=manifest, progress=progress)
    return MapResult(tuple(files), summary, done.points, done.ground_only, inputs.skipped, clock.seconds)


def _executor(
    config: MapConfig, work: BlockWork, space: Workspace, budget: Budget, progress: Progress, pool: WorkerPool | None
) -> Executor:
    if pool is None:
        return LocalExecutor(work, space, budget, progress)
    return ClusterExecutor(
        work, space, budget, progress, pool, _read_options(config), partial(_versions, config.ground)
    )


def _read_options(config: MapConfig) -> ReadOptions:
    return ReadOptions(config.crs, config.z_unit, config.trust_points, memory_bytes(config.memory))


def _check_out(config: MapConfig) -> bool:
    """Make sure that the products can be written; True where a run has ended there and shall stay."""
    unfinished = check_interrupted(config.out, resume=config.resume, overwrite=config.overwrite)
    if not (unfinished or config.overwrite) and is_complete(config.out):
        return True
    # A run that is gone on with may replace what it could replace when it began: its own layers, if it was killed
    # between moving them to their places and clearing up.
    check_folder(config.out, overwrite=config.overwrite or unfinished, resume=config.resume)
    return False


def _done_before(config: MapConfig, run_spec: Mapping[str, Any]) -> MapResult:
    """Give what the run noted that is complete in ``out``; refuse where it was asked something else."""
    names = [name for name in PRODUCT_NAMES if name != MANIFEST_NAME]
    with verified_record(config.out, names) as record:
        skipped = {str(path): str(why) for path, why in record["skipped"].items()}
        no_say = _NO_SAY if skipped else {*_NO_SAY, "skip_bad"}
        before = spec_of_manifest(
            record, no_say, {"model": record["model"], "calibration": record["calibration"]["id"]}
        )
        summary = MapSummary.of(record["counts"])
        points, ground_only, seconds = record["points"], record["ground_only"], record["seconds"]
    now = {**run_spec, "settings": flat_settings(config, no_say)}
    refuse_replacing(config.out, differences(before, now, same_content))
    files = tuple(config.out / name for name in PRODUCT_NAMES)
    return MapResult(files, summary, points, ground_only, skipped, seconds, already_done=True)


def _advice(config: MapConfig) -> str:
    return ADVICE.replace("to the same command", "in the place of `overwrite=True`") if config.overwrite else ADVICE


def _asked(
    config: MapConfig, inputs: _Inputs, budget: Budget, model: TextureModel, calibration: Calibration
) -> dict[str, Any]:
    """Everything that a run depends on; one that goes on must have been asked the same."""
    paths = [*(reader.info.path for reader in inputs.readers), *inputs.skipped]
    return {
        "inputs": {str(path): _identity(path) if str(path) in inputs.skipped else identity(path) for path in paths},
        "settings": flat_settings(config, _NO_SAY),
        "made with": _versions(config.ground) | {"model": model.id, "calibration": calibration.id},
        "cut": {"chunk_points": budget.chunk_points},
    }


def _identity(path: Path | str) -> dict[str, Any] | None:
    """Tell a skipped file from another; None where not even that can be read."""
    try:
        return identity(path)
    except BadInputError:
        return None


def _manifest(
    config: MapConfig,
    inputs: _Inputs,
    run_spec: Mapping[str, Any],
    done: MeasuredTiles,
    model: TextureModel,
    calibration: Calibration,
    clock: Stopwatch,
) -> dict[str, Any]:
    read = zip(inputs.readers, done.dropped, strict=True)
    return {
        "inputs": [_input_record(reader, dropped) for reader, dropped in read if dropped is not None],
        "skipped": inputs.skipped,
        "skipped_inputs": [{"path": path, **_noted(run_spec["inputs"][path])} for path in inputs.skipped],
        "settings": config,
        "versions": _versions(config.ground),
        "ground_only": done.ground_only,
        "points": done.points,
        "model": model.id,
        "calibration": {
            "id": calibration.id,
            "vehicle": calibration.vehicle["name"],
            "preferences": calibration.preferences,
            "class_limits": calibration.class_limits,
        },
        "seconds": clock.seconds,
    }


def _versions(ground: Ground) -> dict[str, str]:
    """Versions of everything that has a say in the numbers of a run."""
    return software_versions() | (filter_version() if ground == "csf" else {})


def _open(config: MapConfig) -> _Inputs:
    """Open every input; settle on one CRS before the long work begins."""
    readers: list[SurveyReader] = []
    skipped: dict[str, str] = {}
    for path in find_surveys(config.surveys):
        try:
            readers.append(open_survey(path, _read_options(config)))
        except BadInputError as error:
            _note(path, error, skipped, config)
    if not readers:
        raise BadInputError("none of the inputs could be read:", *skipped.values())
    georeference = common_georeference([reader.info for reader in readers])
    if georeference.crs is not None and config.local:
        _log.warning("`local=True` is not needed: the survey has a CRS (%s)", georeference.crs.name)
    if georeference.crs is None and not config.local:
        raise BadInputError(
            f"{readers[0].info.path} has no CRS, so its location on Earth is unknown. Pass `crs='EPSG:CODE'`, "
            "or `local=True` to map it in its own coordinates (rasters without a CRS, cost.geojson in local metres)"
        )
    return _Inputs(readers, georeference, skipped)


def _check_span(inputs: _Inputs, grid: Grid, window: TileWindow) -> None:
    """Refuse a map that spans too much, and say of which files."""
    try:
        check_extent(grid, window)
    except BadInputError as error:
        paths = [str(reader.info.path) for reader in inputs.readers if str(reader.info.path) not in inputs.skipped]
        shown = paths if len(paths) <= _NAMED else [*paths[:_NAMED], f"{len(paths) - _NAMED} more"]
        raise BadInputError(f"{error}. The files read are: {', '.join(shown)}") from error


def _skip(inputs: _Inputs, config: MapConfig, reader: SurveyReader, error: BadInputError) -> None:
    _note(reader.info.path, error, inputs.skipped, config)


def _note(path: Path | str, error: BadInputError, skipped: dict[str, str], config: MapConfig) -> None:
    """Note a bad input and go on, or raise."""
    if not config.skip_bad:
        raise error
    _log.warning("skipped %s: %s", path, error)
    skipped[str(path)] = str(error)


def _noted(identity: Mapping[str, Any] | None) -> dict[str, Any]:
    """Pick what tells a file from its later version without reading it."""
    return {key: identity[key] for key in ("mtime_ns", "version") if key in identity} if identity else {}


def _input_record(reader: SurveyReader, dropped: dict[str, int]) -> dict[str, Any]:
    info = reader.info
    record = {
        "path": info.path,
        "format": info.format,
        "points": info.point_count,
        "dropped": dropped,
        "notes": info.notes,
    }
    version = dict(info.version or {})
    record |= {"bytes": version.pop("size", info.size_bytes)} | version
    # A file on a server is not read again for its checksum.
    return record | ({"sha256": None} if isinstance(info.path, str) else {})
