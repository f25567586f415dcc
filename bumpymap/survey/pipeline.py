"""The main job, step by step: surveys in, rated tiles and their files out; what it depends on, and ``run.json``."""

import logging
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import date
from functools import partial
from logging.handlers import QueueHandler
from os.path import abspath
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from bumpymap.core import (
    BadInputError,
    CostTable,
    Ground,
    MapConfig,
    OutputError,
    PageSettings,
    Progress,
    SilentProgress,
    Stopwatch,
    differences,
    flat_settings,
    is_interrupted,
    join_checksums,
    limit_arenas,
    locked,
    memory_bytes,
    photo_column,
    rated_columns,
    recorded_settings,
    remove_empty_on_error,
    return_memory,
    same_content,
    spec_of_manifest,
)
from bumpymap.layers import (
    EVERY_VIEW_NAME,
    MANIFEST_NAME,
    PRODUCT_NAMES,
    MapSummary,
    check_folder,
    is_complete,
    refuse_replacing,
    software_versions,
    verified_record,
)
from bumpymap.patches import close_filter, filter_version, relief_margin, require_filter
from bumpymap.rating import DRIVE_LOG_SD, map_rule
from bumpymap.readers import Location, hash_survey, identity, project_photo
from bumpymap.survey.engine import (
    BlockWork,
    Budget,
    ClusterExecutor,
    Executor,
    LocalExecutor,
    MeasuredTiles,
    Workspace,
    connect,
    engine_errors,
    run_engine,
    with_memory,
)
from bumpymap.survey.flight_lines import FlightLines, compare_lines
from bumpymap.survey.inputs import SurveyInputs, read_options
from bumpymap.survey.tile_rating import NeighbourRating, RatingModels, TileRating, finish_tiles


@contextmanager
def collected_warnings(*, alone: bool = False) -> Iterator[list[str]]:
    """Collect the warnings of this thread during the body, beside their being logged; the list is filled at its end.

    ``alone``: instead of that, those of all threads, and of the engine.
    """
    kept, said, thread = list[str](), SimpleQueue[logging.LogRecord](), threading.get_ident()
    collector = QueueHandler(said)
    collector.setLevel(logging.WARNING)
    collector.addFilter(lambda record: alone or record.thread == thread)
    loggers = [logging.getLogger(name) for name in (("bumpymap", "bumpytiles") if alone else ("bumpymap",))]
    before = [(logger.handlers, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.handlers = [collector] if alone else [*logger.handlers, collector]
        logger.propagate = logger.propagate and not alone
    try:
        yield kept
    finally:
        for logger, (handlers, propagate) in zip(loggers, before, strict=True):
            logger.handlers, logger.propagate = handlers, propagate
        kept += [said.get().getMessage() for _ in range(said.qsize())]


@dataclass(frozen=True, slots=True)
class MapResult:
    """Files and findings of a run."""

    files: tuple[Path, ...]
    """Files written, in the order of writing."""
    summary: MapSummary
    """Statistics of the rated tiles."""
    points: int
    """Points read that are neither withheld nor noise; duplicates are included."""
    ground_only: bool
    """Only ground was measured: points of ground classes, or those that the cloth filter found (``ground = "csf"``)."""
    skipped: dict[str, str]
    """Inputs that could not be read, with the error message (``skip_bad``)."""
    seconds: dict[str, float]
    """Wall time by stage."""
    lines: FlightLines
    """Steps between flight lines."""
    already_done: bool = False
    """An earlier run with the same inputs and settings is complete: nothing was written, and these are its results."""
    from_all: int = 0
    """With ``ground_only``, tiles measured from all points nevertheless: that part of the survey is not classified."""


def survey_record(
    given: Sequence[Location], files: Sequence[Location], checksums: Sequence[str | None], dates: Sequence[date | None]
) -> dict[str, Any]:
    """Return name, checksum and dates of a survey; nothing in them depends on where its files lie.

    ``given``: files and folders as the user named them; ``files``: the files that were read; ``checksums``: checksum of
    each file; ``dates``: date in the header of each file. Returns ``name``: that of the one file without its suffix, or
    of the folder that was given or that holds all files, or ``N files``. ``checksum``: that of the one file, or one
    made from those of all; None if a file has none. ``dates``: the first and the last in the headers, ISO 8601; None if
    no header has one.
    """
    paths = [Path(abspath(file)) for file in files]  # noqa: PTH100 (resolve() follows links)
    if len(paths) == 1:
        name = paths[0].stem.removesuffix(".copc") or paths[0].name
    else:
        folders = {path.parent for path in paths} if len(given) > 1 else {Path(abspath(given[0]))}  # noqa: PTH100
        name = (folders.pop().name if len(folders) == 1 else "") or f"{len(files)} files"
    known = [checksum for checksum in checksums if checksum is not None]
    whole = len(known) == len(files)
    days = sorted(day for day in dates if day is not None)
    return {
        # Metadata of layers cannot hold what is not text: bytes that are not UTF-8, control characters.
        "name": "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in name),
        "checksum": None if not whole else known[0] if len(known) == 1 else join_checksums(known),
        "dates": [days[0].isoformat(), days[-1].isoformat()] if days else None,
    }


_WITHOUT_EFFECT = {"surveys", "max_unknown"}
"""Settings that do not change the results: a resumed run may use other values."""


def versions(ground: Ground) -> dict[str, str]:
    """Return the versions of the software that the results depend on."""
    return software_versions() | (filter_version() if ground == "csf" else {})


def describe_run(config: MapConfig, inputs: SurveyInputs, models: RatingModels, budget: Budget) -> dict[str, Any]:
    """Return everything that the results depend on; a resumed run must have the same."""
    return {
        "inputs": {str(path): _identity(path, required=str(path) not in inputs.skipped) for path in inputs.paths},
        "settings": flat_settings(config, _WITHOUT_EFFECT),
        "made with": versions(config.ground)
        | {"model": models.texture_id, "calibration": models.calibration.id}
        | ({} if config.photo is None else {"photo": identity(config.photo)["digest"]}),
        "cut": {"chunk_points": budget.chunk_points},
    }


def earlier_result(config: MapConfig, run_spec: Mapping[str, Any]) -> MapResult:
    """Return the recorded result of the complete run in ``config.out``, whose layers are verified.

    Raises OutputError: that run had other inputs or settings, or its layers are no longer complete.
    """
    must = [name for name in PRODUCT_NAMES if name != MANIFEST_NAME]
    with verified_record(config.out, must) as record:
        skipped = {str(path): str(why) for path, why in record["skipped"].items()}
        ignored = _WITHOUT_EFFECT if skipped else {*_WITHOUT_EFFECT, "skip_bad"}
        before = spec_of_manifest(
            record,
            ignored,
            {"model": record["model"], "calibration": record["calibration"]["id"]}
            | ({"photo": record["photo"]} if "photo" in record else {}),
        )
        summary = MapSummary.of(record["counts"])
        points, ground_only, seconds = record["points"], record["ground_only"], record["seconds"]
        from_all = record.get("tiles_from_all_points", 0)
        lines = FlightLines.from_record(record["flight_lines"])
        names = [str(file["path"]) for file in record["files"]]
    now = {**run_spec, "settings": flat_settings(config, ignored)}
    refuse_replacing(config.out, differences(before, now, partial(same_content, hashed=hash_survey)))
    # Views may be deleted, or rewritten by other programs.
    views = [name for name in EVERY_VIEW_NAME if (config.out / name).exists()]
    files = tuple(config.out / name for name in (*names, MANIFEST_NAME, *views))
    return MapResult(files, summary, points, ground_only, skipped, seconds, lines, True, from_all)


def run_manifest(
    config: MapConfig,
    inputs: SurveyInputs,
    run_spec: Mapping[str, Any],
    measured: MeasuredTiles,
    models: RatingModels,
    seconds: Mapping[str, float],
    lines: FlightLines,
    warnings: Sequence[str],
) -> dict[str, Any]:
    """Return what ``run.json`` says beside the statistics of the tiles; ``warnings`` are those before the points."""
    every = zip(inputs.readers, measured.dropped, measured.checksums, strict=True)
    read = [(reader.info, dropped, checksum) for reader, dropped, checksum in every if dropped is not None]
    calibration, skipped = models.calibration, inputs.skipped
    # The part of the intervals that all maps with this calibration share.
    error = float(calibration.ride["model_error"]) if config.by_ride else 0.0
    return {
        "survey": survey_record(
            config.surveys,
            [info.path for info, _, _ in read],
            [checksum for _, _, checksum in read],
            [info.header_date for info, _, _ in read],
        ),
        "inputs": [
            {
                "path": str(info.path),
                "format": info.format,
                "points": info.point_count,
                "dropped": dropped,
                "notes": info.notes,
                "bytes": info.version["size"],
                "mtime_ns": info.version["mtime_ns"],
                "checksum": checksum,
            }
            for info, dropped, checksum in read
        ],
        "skipped": {str(path): why for path, why in skipped.items()},
        "warnings": list(dict.fromkeys((*warnings, *(f"skipped {path}: {why}" for path, why in skipped.items())))),
        "skipped_inputs": [
            # What shows a change without reading the file.
            {"path": str(path)} | ({"mtime_ns": known["mtime_ns"]} if "mtime_ns" in known else {})
            for path, known in ((path, run_spec["inputs"][path] or {}) for path in skipped)
        ],
        "settings": {**recorded_settings(config), "surveys": list(map(str, config.surveys))},
        "versions": versions(config.ground),
        "ground_only": measured.ground_only,
        **({"tiles_from_all_points": measured.from_all} if measured.from_all else {}),
        "points": measured.points,
        "flight_lines": lines,
        "model": models.texture_id,
        **({"photo": run_spec["made with"]["photo"]} if config.photo else {}),
        "calibration": {
            "id": calibration.id,
            "vehicle": calibration.profile.name,
            "preferences": calibration.preferences,
            "class_limits": calibration.map_limits,
            **({"floor_radpm": calibration.map_floor} if calibration.map_floor else {}),
            **({"model_error": error} if error else {}),
        },
        "vehicle": {
            "name": calibration.profile.name,
            "width_m": calibration.body.width_m,
            "height_m": calibration.body.height_m,
            "clearance_m": calibration.body.clearance_m,
            "speed_mps": calibration.map_speed,
        }
        | ({} if config.speed is None else {"drives_mps": calibration.profile.speed_mps}),
        "seconds": seconds,
    }


def _identity(path: Path, *, required: bool) -> dict[str, Any] | None:
    try:
        return identity(path)
    except BadInputError:  # even that of a skipped file may not be readable
        if required:
            raise
        return None


_COLOURED = 0.1
"""Share of points with a colour from which on there is a photo."""


def map_surveys(config: MapConfig, progress: Progress | None = None, *, in_batch: bool = False) -> MapResult:
    """Map surveys: read, cut into tiles, measure, classify, rate, write.

    ``in_batch``: the run is one of many. A survey that states another CRS than ``config.crs`` is mapped in its own,
    with a warning, instead of being refused; with ``config.overwrite``, layers of the same inputs and settings are
    kept; an interrupted run of others that has left no layers is replaced. Raises BumpymapError: bad inputs or
    settings, or a full disk; no file is left half-written.
    """
    try:
        with remove_empty_on_error(config.out), locked(config.out):
            config = config if config.photo else replace(config, photo=project_photo(config.surveys))
            return _map(with_memory(config), progress or SilentProgress(), in_batch=in_batch)
    finally:
        close_filter()


def _map(config: MapConfig, progress: Progress, *, in_batch: bool) -> MapResult:
    clock = Stopwatch()
    budget = Budget(memory_bytes(config.memory), config.threads)
    limit_arenas(budget.threads)
    overwrite, unfinished, complete = config.overwrite, is_interrupted(config.out), is_complete(config.out)
    keeps = complete and not unfinished and (in_batch or not overwrite)
    with clock.stage("prepare"), collected_warnings() as warnings:
        if not keeps:
            # A continued run may replace what it could replace when it began: if it was killed between moving its
            # layers to their places and clearing up, they are its own.
            check_folder(config.out, overwrite=overwrite or unfinished)
        header = {}
        if config.page != PageSettings():
            from bumpymap.views import page_header

            header = page_header(config.page)
        models, inputs, neighbours = _prepare(config, crs_must_agree=not in_batch)
        # A setting without effect is none of the run: a batch that gives it for one survey begins no other anew.
        config = replace(config, local=config.local and inputs.georeference.crs is None)
        run_spec = describe_run(config, inputs, models, budget)
    if keeps:
        try:
            return earlier_result(config, run_spec)
        except OutputError:
            if not overwrite:
                raise
        check_folder(config.out, overwrite=True)
    discard = overwrite or (in_batch and not complete)
    grid = config.grid
    most_seen = min(reader.info.most_seen for reader in inputs.readers)
    rating = TileRating.of(config, models, most_seen)
    in_relief = rating.measure_all if config.compat == "none" else None  # the paper knows no obstacles
    columns = rated_columns(grid.pixels)
    if any(reader.has_colour for reader in inputs.readers):
        columns = (*columns, photo_column(grid.pixels))
    work = BlockWork(grid, columns, rating, config.ground, in_relief, relief_margin(grid))
    # Workers first: a failure to connect must not cost what an earlier run has finished.
    with (
        connect(config.scheduler) as workers,
        Workspace.opened(config.out, config.scratch, run_spec, overwrite=discard) as space,
    ):
        executor: Executor = LocalExecutor(work, space, budget, progress)
        if workers is not None:
            fits = partial(versions, config.ground)
            executor = ClusterExecutor(work, space, budget, progress, workers, read_options(config), fits)
        measured = run_engine(inputs, work, space, budget, executor, progress, clock)
        return_memory()  # of the points
        with clock.stage("neighbours"), engine_errors(budget):
            tiles = finish_tiles(measured.table, neighbours, space.new_tiles, config.threads, progress)
        rule = map_rule(models.calibration)
        table = CostTable(
            inputs.georeference,
            replace(rule, drive_log_sd=DRIVE_LOG_SD) if config.by_ride else rule,
            tiles,
            has_photo=measured.coloured >= _COLOURED * measured.points,
            orthophoto=inputs.photo,
        )
        lines = compare_lines(measured.lines)
        manifest = run_manifest(config, inputs, run_spec, measured, models, clock.seconds, lines, warnings)
        manifest |= {"page": header} if header else {}
        return_memory()  # of the windows
        with clock.stage("write"):
            # These bring GDAL and Arrow, for which reading need not wait.
            from bumpymap.layers import write_products
            from bumpymap.views import write_map_views

            files, summary = write_products(
                table, config.out, local=config.local, manifest=manifest, views=write_map_views, progress=progress
            )
    points, only, every = measured.points, measured.ground_only, measured.from_all
    return MapResult(tuple(files), summary, points, only, inputs.skipped, clock.seconds, lines, from_all=every)


def _prepare(config: MapConfig, *, crs_must_agree: bool) -> tuple[RatingModels, SurveyInputs, NeighbourRating]:
    """Load the models and open the surveys."""
    if config.ground == "csf":
        require_filter(config.csf, config.grid)
    models = RatingModels.load(config)
    inputs = SurveyInputs.open(config, crs_must_agree=crs_must_agree)
    return models, inputs, NeighbourRating(config, models.calibration)
