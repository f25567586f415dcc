"""What a run says at its end: the unknown share, whether the ground was chosen well, and when it must not pass."""

from bumpymap.core import REASON_TEXT, MapConfig, Reason, TooUnknownError
from bumpymap.layers import MapSummary
from bumpymap.survey.advice import Measured, Outcome, advise
from bumpymap.survey.result import MapResult
from bumpytiles import Grid

__all__ = ["ground_line", "outcome_of_run", "require_known", "unknown_line"]

_MEASURED: tuple[Measured, Measured] = ("ground points (class 2)", "ground points (found by the cloth)")
"""Source of the ground points: the survey, or the cloth filter."""
_LAYERED_SHARE = 0.25
_TALL_SHARE = 0.5
"""Above one of these shares of tiles the cloth filter is advised. Layered and tall, all points measured: forest by
airborne LiDAR 83 % and 90 %, another 49 % and 79 %; scrub and lava by drone photogrammetry 5 % and 21 %, quarry with a
few trees 6 % and 5 %, a survey of 1.4 points per m2 4 % and 1 %."""
_SOME_SHARE = 0.1
"""Up to this share of tall tiles nothing is said: then hardly anything stands on the ground."""


def outcome_of_run(result: MapResult, config: MapConfig) -> Outcome:
    """Return how many tiles of a run are unknown, and how many points they held."""
    summary = result.summary
    return Outcome(
        tiles=summary.tiles,
        unknown={code: summary.by_reason[code] for code in Reason if summary.by_reason[code]},
        measured=_MEASURED[config.ground == "csf"] if result.ground_only else "points",
        points_per_tile=summary.median_count,
        all_points_per_tile=result.points / summary.tiles,
        thin=result.rates_thin,
    )


def unknown_line(result: MapResult, config: MapConfig) -> str:
    """Return in one line the share of unknown tiles, why, and, if there are many, what would help."""
    outcome = outcome_of_run(result, config)
    if advice := advise(outcome, Grid(config.tile_size, config.pixels), config.features, before_run=False):
        return advice
    if not outcome.unknown:
        return "no tile with points is unknown"
    most = max(outcome.unknown, key=lambda reason: outcome.unknown[reason])
    return f"{outcome.share:.1%} of the tiles are unknown, mostly because of {REASON_TEXT[most]}"


def ground_line(result: MapResult) -> str:
    """Return in one line which points should be measured, if all were; empty if nothing stands on the ground.

    In a *layered* tile the points of a pixel lie far above one another, as LiDAR sees vegetation and the ground below
    it; in a *tall* one points lie far from the plane through the tile, see `MapSummary`.
    """
    summary = result.summary
    if result.ground_only or not summary.judged:
        return ""
    layered, tall = summary.layered / summary.judged, summary.tall / summary.judged
    if layered >= _LAYERED_SHARE or tall >= _TALL_SHARE:
        return (
            f"all points count as ground, but in {max(layered, tall):.0%} of the tiles something tall stands on it, as "
            "trees and buildings do: `ground='csf'` looks for the ground beneath"
        )
    if tall > _SOME_SHARE:
        return (
            f"all points count as ground, so what stands on it is part of the relief; {tall:.0%} of the tiles hold "
            "scrub, rock or walls of which only the top is seen: `ground='all'` (as here) keeps them, `ground='csf'` "
            "takes them away"
        )
    return ""


def require_known(result: MapResult, config: MapConfig, *, explain: bool = True) -> None:
    """Raise TooUnknownError if more than the share ``max_unknown`` of the tiles with points is unknown.

    The message says why and what would help if ``explain``.
    """
    outcome = outcome_of_run(result, config)
    if config.max_unknown is None or outcome.share <= config.max_unknown:
        return
    raise TooUnknownError(
        f"more than `max_unknown={config.max_unknown:g}` of the tiles is unknown: {_share(result.summary)}. The layers "
        f"in {config.out} are complete",
        *([unknown_line(result, config)] if explain else []),
    )


def _share(summary: MapSummary) -> str:
    return f"{summary.unknown:,} of {summary.tiles:,} ({summary.unknown / summary.tiles:.1%})"
