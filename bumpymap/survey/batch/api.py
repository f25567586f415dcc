"""Map many surveys from Python: one call that returns what became of each."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Unpack

from bumpymap.core import UsageError, path_of_call, refuse_unknown, short_repr
from bumpymap.layers import SurveyRow
from bumpymap.survey.api import EachSettings, PathLike, map_settings
from bumpymap.survey.batch.night import BatchResult, run_batch
from bumpymap.survey.batch.settings import BatchConfig, SurveyPer

__all__ = ["BatchSettings", "map_batch"]

_OF_BATCH = ("survey_per", "jobs")


class BatchSettings(EachSettings, total=False):
    """Settings of `map_batch`: those of ``BatchConfig``, and of ``MapConfig`` for each survey."""

    survey_per: SurveyPer
    jobs: int


def map_batch(
    source: PathLike,
    out: PathLike,
    report: Callable[[SurveyRow], None] | None = None,
    **settings: Unpack[BatchSettings],
) -> BatchResult:
    """Map many surveys, each to a folder of its own, as ``bumpymap batch`` does.

    The same call again skips what is done, continues what was interrupted and tries again what has failed. A survey
    that fails raises nothing: its row says why.

    Parameters
    ----------
    source : path
        A folder of surveys; a ``.txt`` file with a path in each line; or a ``.csv`` file with the column ``survey``.
    out : path or URL
        Gets a folder of layers for each survey, the summary and index.html.
    report : callable, optional
        Called with the `SurveyRow` of each survey when it has ended.
    **settings
        ``survey_per`` and ``jobs``, and those of `map_survey` but ``resume``, for all surveys. They override the
        columns of a CSV.

    Returns
    -------
    BatchResult
        ``rows``: one for each survey, by name, with the columns of summary.csv. ``exit_code``: that of the command:
        0 all are done, 4 some are, 3 none.

    Raises
    ------
    BumpymapError
        The source holds no surveys, a setting is not allowed, or ``out`` cannot be used.

    Examples
    --------
    >>> import bumpymap
    >>> night = bumpymap.map_batch("sample_data", "night", ground="all")
    >>> [(row.name, row.status) for row in night.rows]
    [('quarry', 'done'), ('quarry_part', 'failed')]
    >>> night.exit_code
    4
    """
    known = [*_OF_BATCH, *EachSettings.__annotations__]
    refuse_unknown(settings, known, "map_batch")
    given: dict[str, Any] = {name: value for name, value in settings.items() if value is not None}
    own = {name: given.pop(name) for name in _OF_BATCH if name in given}
    if report is not None and not callable(report):
        raise UsageError(f"report is {short_repr(report)}; it must be a function that takes a row")
    places = [path_of_call("source", source), path_of_call("out", out)]
    target = places[1] if "://" in places[1] else Path(places[1])
    config = BatchConfig(Path(places[0]), target, map_settings(given, "map_batch", known), **own)
    return run_batch(config, report)
