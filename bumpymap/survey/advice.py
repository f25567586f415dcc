"""How many tiles of a survey are unknown, why, and what would help; and what a run says of it at its end."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from bumpymap.core import REASON_TEXT, THIN_POINTS, FeatureSettings, MapConfig, Reason, TooUnknownError
from bumpymap.survey.pipeline import MapResult

Measured = Literal["points", "ground points", "ground points (found by the cloth)"]
_FEW_UNKNOWN = 0.1
"""Up to this share of unknown tiles no advice is given: every survey has some at its edge."""
_FAR_FEWER = 0.5
"""Below this part of the unknown tiles another option is advised."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The tiles of a survey, after a run or forecast."""

    tiles: int
    """Number of tiles that hold a point."""
    unknown: Mapping[Reason, float]
    """Number of tiles without a class, by reason."""
    measured: Measured
    """The points that a run measures."""
    points_per_tile: float
    """Median number of measured points per tile."""
    all_points_per_tile: float
    """Mean number of points per tile, of all classes."""
    thin: bool
    """Thin tiles are rated from their points, as with ``rating = "ride"``."""

    @property
    def share(self) -> float:
        """Share of unknown tiles, 0..1."""
        return sum(self.unknown.values()) / self.tiles if self.tiles else 0.0


def enough_points(settings: FeatureSettings, *, thin: bool) -> int:
    """Return the number of points without which a tile has no class; ``thin``: the rule of thin tiles holds as well."""
    return min(settings.min_points, THIN_POINTS) if thin else settings.min_points


def advise(outcome: Outcome, settings: FeatureSettings, *, would_help: Mapping[str, float] | None = None) -> str:
    """Return in one line which share of the tiles is unknown, why, and what would help; empty if there are few.

    ``settings``: limits of the dense rule; ``would_help``: before a run: share of unknown tiles with other options.
    Those that leave far fewer unknown are advised.
    """
    if outcome.share <= _FEW_UNKNOWN:
        return ""
    most = max(outcome.unknown, key=lambda reason: outcome.unknown[reason])
    share = f"{outcome.share:.1%}" if would_help is None else f"about {outcome.share:.0%}"
    head = f"{share} of the tiles {'are' if would_help is None else 'will be'} unknown"
    why, help_ = _explained(most, outcome, settings)
    if would_help is not None and most is not Reason.OUTLIER_RELIEF:
        better = {option: left for option, left in would_help.items() if left < _FAR_FEWER * outcome.share}
        options = " and ".join(f"{option} would leave about {left:.0%} unknown" for option, left in better.items())
        help_ = options or "Larger tiles would not help: there are gaps in the survey, or too few points"
    return f"{head}, mostly because of {REASON_TEXT[most]}: {why}. {help_}"


def _explained(reason: Reason, outcome: Outcome, settings: FeatureSettings) -> tuple[str, str]:
    """Return the rule that most of the unknown tiles break, and what may help after a run."""
    if reason is Reason.OUTLIER_RELIEF:
        why = f"more than {settings.stray_share:.0%} of their points are cut off from all others in height"
        return why, "Mark stray points as noise (class 7 or 18), or raise stray_share in [features] of --config"
    enough = enough_points(settings, thin=outcome.thin)
    if reason is not Reason.TOO_MANY_HOLES:
        held = f"{outcome.points_per_tile:.0f} {outcome.measured}"
        why = f"{held} per tile (median); at least {enough} are needed"
    elif outcome.thin:
        why = "no point in most parts of the tile"
    else:
        why = (
            f"ground more than {settings.max_hole:g} m from every pixel with a point, or less than "
            f"{settings.min_coverage:.0%} of the pixels with one"
        )
    if outcome.measured == "points" or outcome.all_points_per_tile < enough:
        return why, (
            "A denser survey would help, or larger tiles if it has no gaps: bumpymap info SURVEY says how many they "
            "would leave unknown; vehicles of your own, and other sizes, need a calibration of their own"
        )
    text = f"--ground all measures every point, {outcome.all_points_per_tile:.0f} per tile on average, vegetation too"
    if outcome.measured == "ground points":
        text += "; --ground csf detects ground points where the survey has any; bumpymap info names classes that lie "
        text += "on the ground and are left out, for --ground-classes"
    return why, text


_MEASURED: tuple[Measured, Measured] = ("ground points", "ground points (found by the cloth)")
"""Source of the ground points: the survey, or the cloth filter."""
_LAYERED_SHARE, _TALL_SHARE = 0.25, 0.5
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
        thin=config.by_ride,
    )


def unknown_line(result: MapResult, config: MapConfig) -> str:
    """Return in one line the share of unknown tiles, why, and, if there are many, what would help."""
    outcome = outcome_of_run(result, config)
    if advice := advise(outcome, config.features):
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
            f"all points count as ground, so objects on it are part of the relief; {tall:.0%} of the tiles hold "
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
    summary = result.summary
    raise TooUnknownError(
        f"{summary.unknown:,} of {summary.tiles:,} tiles are unknown ({outcome.share:.1%}), more than the "
        f"{100.0 * config.max_unknown:g}% that `max_unknown` allows. The layers in {config.out} are complete",
        *([unknown_line(result, config)] if explain else []),
    )
