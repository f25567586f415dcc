"""The main job, step by step: surveys in, rated tiles and their files out."""

from dataclasses import replace
from functools import partial

from bumpymap.core import (
    CostTable,
    MapConfig,
    OutputError,
    PageSettings,
    Progress,
    SilentProgress,
    Stopwatch,
    is_interrupted,
    limit_arenas,
    locked,
    memory_bytes,
    photo_column,
    rated_columns,
    remove_empty_on_error,
    return_memory,
)
from bumpymap.layers import check_folder, is_complete
from bumpymap.patches import close_filter, relief_margin, require_filter
from bumpymap.rating import DRIVE_LOG_SD, map_rule
from bumpymap.readers import project_photo
from bumpymap.survey.engine import (
    BlockWork,
    Budget,
    ClusterExecutor,
    Executor,
    LocalExecutor,
    Workspace,
    connect,
    engine_errors,
    run_engine,
    with_memory,
)
from bumpymap.survey.flight_lines import compare_lines
from bumpymap.survey.inputs import SurveyInputs, read_options
from bumpymap.survey.run_record import (
    MapResult,
    collected_warnings,
    describe_run,
    earlier_result,
    run_manifest,
    versions,
)
from bumpymap.survey.tile_rating import NeighbourRating, RatingModels, TileRating, finish_tiles

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
    columns = rated_columns(grid.pixels, headings=config.headings)
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
