"""How many tiles of a survey are unknown, why, and what would help; and what a run says of it at its end."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from bumpymap.core import REASON_TEXT, THIN_PARTS, THIN_POINTS, FeatureSettings, MapConfig, Reason, TooUnknownError
from bumpymap.survey.run_record import MapResult
from bumpytiles import Grid

__all__ = [
    "Measured",
    "Outcome",
    "advise",
    "enough_points",
    "ground_line",
    "models_for",
    "outcome_of_run",
    "require_known",
    "size_options",
    "unknown_line",
]

Measured = Literal["points", "ground points", "ground points (found by the cloth)"]
_FEW_UNKNOWN = 0.1
"""Up to this share of unknown tiles no advice is given: every survey has some at its edge."""
_LARGEST_TILE = 20
"""Largest tile that advice suggests, m: larger ones say little about what a wheel meets."""
_ALMOST_ALL = 1.5
"""With this many times the points of `enough_points` almost all tiles are known. Dense rule: of 4,000 tiles with random
points, 49 % had too many holes with 65 points, 2.4 % with 72, none with 90. Thin rule: where tiles hold 22 points on
average, 5 % hold fewer than 15."""
_LEAST_HELD = 2
"""Points of the median tile from which larger ones are suggested: with fewer, most tiles may hold no point at all."""
_MOSTLY_EDGE = 16
"""Up to this number of tiles, 4 x 4, most are at the edge."""


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
    """Thin tiles are rated from their points, as with ``rating = "ride"`` and a calibration that has ``thin``."""

    @property
    def share(self) -> float:
        """Share of unknown tiles, 0..1."""
        return sum(self.unknown.values()) / self.tiles if self.tiles else 0.0


def enough_points(grid: Grid, settings: FeatureSettings, *, thin: bool) -> int:
    """Return the number of points with which a tile can probably be classified.

    Parameters
    ----------
    grid : Grid
        Grid of the tiles.
    settings : FeatureSettings
        Limits of the dense rule. Points scattered at random over ``m`` pixels leave a pixel empty with probability
        ``exp(-n / m)``, so ``n`` points cover the share ``1 - exp(-n / m)``.
    thin : bool
        The rule of thin tiles holds as well. Points at random that are enough for it nearly always span the tile: 15
        leave a hole in one of 1,500 tiles.
    """
    for_coverage = -math.log1p(-min(settings.min_coverage, 0.999)) * grid.pixels**2
    dense = max(settings.min_points, math.ceil(for_coverage))
    return min(dense, THIN_POINTS) if thin else dense


def advise(outcome: Outcome, grid: Grid, settings: FeatureSettings, *, before_run: bool) -> str:
    """Return in one line which share of the tiles is unknown, why, and what would help; empty if there are few.

    Parameters
    ----------
    outcome : Outcome
    grid : Grid
        Grid of the tiles.
    settings : FeatureSettings
        Limits of the dense rule.
    before_run : bool
        Whether the run is still to come.
    """
    if outcome.share <= _FEW_UNKNOWN:
        return ""
    most = max(outcome.unknown, key=lambda reason: outcome.unknown[reason])
    share = f"about {outcome.share:.0%}" if before_run else f"{outcome.share:.1%}"
    head = f"{share} of the tiles {'will be' if before_run else 'are'} unknown"
    why, help_ = {
        Reason.TOO_MANY_HOLES: _holes,
        Reason.OUTLIER_RELIEF: _outliers,
    }.get(most, _too_few)(outcome, grid, settings)
    return f"{head}, mostly because of {REASON_TEXT[most]}: {why}. {help_}"


def models_for(grid: Grid) -> str:
    """Return the commands that make and use the calibration for tiles of another size."""
    size = size_options(grid)
    return (
        "a calibration that drives patches of that size: "
        f"bumpymap calibrate --vehicle NAME_OR_FILE {size} --out my.json; then "
        f"bumpymap map {size} --calibration my.json"
    )


def size_options(grid: Grid) -> str:
    """Return the options of a grid; empty for the default one."""
    size = f"--tile-size {grid.tile_size:g}" if grid.tile_size != Grid().tile_size else ""
    pixels = f"--set pixels={grid.pixels}" if grid.pixels != Grid().pixels else ""
    return " ".join(filter(None, (size, pixels)))


def _too_few(outcome: Outcome, grid: Grid, settings: FeatureSettings) -> tuple[str, str]:
    enough = enough_points(grid, settings, thin=outcome.thin)
    held = f"{outcome.points_per_tile:.0f} {outcome.measured}"
    held = held.replace("points", "point", 1) if held.startswith("1 ") else held
    few_holes = f", and about {enough} to leave few holes" if enough > settings.min_points else ""
    needed = f"at least {settings.min_points} are needed{few_holes}"
    if outcome.thin:
        needed = f"at least {enough} are needed, in most parts of the tile"
    why = f"{held} per tile (median); {needed}"
    if outcome.measured == "points":
        if outcome.points_per_tile >= _ALMOST_ALL * enough:
            return (
                why,
                "Most tiles hold enough: more points would help at the edge of the survey, and where it is sparse",
            )
        return why, _larger_tiles(outcome, grid, enough)
    if outcome.points_per_tile >= _ALMOST_ALL * enough:
        return why, "Most tiles hold enough; the others have little ground, as under trees and on buildings"
    mean_points = f"{outcome.all_points_per_tile:.0f} per tile on average"
    if outcome.all_points_per_tile < enough:
        return (
            why,
            f"All points (--ground all) are too few as well, {mean_points}. {_larger_tiles(outcome, grid, enough)}",
        )
    return why, _all_points(outcome, mean_points)


def _all_points(outcome: Outcome, mean_points: str) -> str:
    text = f"--ground all measures every point, {mean_points}, vegetation too"
    if outcome.measured == "ground points":
        text += "; --ground csf detects ground points where the survey has any"
    return text


def _larger_tiles(outcome: Outcome, grid: Grid, enough: float) -> str:
    """Suggest larger tiles with the same number of pixels, which hold more points each.

    With the thin rule the number of points alone decides, so the median tile must hold more than enough.
    """
    held = outcome.points_per_tile if outcome.measured == "points" else outcome.all_points_per_tile
    wanted = max(enough, _ALMOST_ALL * THIN_POINTS) if outcome.thin else enough
    size = math.ceil(grid.tile_size * math.sqrt(wanted / max(held, 1.0)))
    if size > _LARGEST_TILE or held < _LEAST_HELD:
        return "The survey is too sparse for this purpose: a denser one is needed"
    larger = Grid(max(size, math.floor(grid.tile_size) + 1), grid.pixels)
    option = size_options(larger) + ("" if outcome.measured == "points" else " --ground all")
    return (
        f"A denser survey would help, or larger tiles: bumpymap info {option} says what they would give; they need "
        f"{models_for(larger)}"
    )


def _holes(outcome: Outcome, grid: Grid, settings: FeatureSettings) -> tuple[str, str]:
    enough = enough_points(grid, settings, thin=outcome.thin)
    why = _what_is_a_hole(outcome, grid, settings)
    if outcome.tiles <= _MOSTLY_EDGE:
        return why, f"The survey has {outcome.tiles} tiles of {grid.tile_size:g} m, most of them at its edge"
    if outcome.measured != "points" and outcome.all_points_per_tile >= enough:
        return why, _all_points(outcome, f"{outcome.all_points_per_tile:.0f} per tile on average")
    if outcome.points_per_tile < _ALMOST_ALL * enough:
        return why, _larger_tiles(outcome, grid, _ALMOST_ALL * enough)
    return why, "Points from more directions would help, or a larger max_hole in [features] of --config"


def _what_is_a_hole(outcome: Outcome, grid: Grid, settings: FeatureSettings) -> str:
    if outcome.thin:
        side = grid.tile_size * (THIN_PARTS - 1) / THIN_PARTS
        return f"no point in a square of {side:.2g} m, or in most of the tile"
    return (
        f"ground more than {settings.max_hole:g} m from every pixel with a point, or less than "
        f"{settings.min_coverage:.0%} of the pixels with one"
    )


def _outliers(outcome: Outcome, grid: Grid, settings: FeatureSettings) -> tuple[str, str]:  # noqa: ARG001
    why = f"more than {settings.stray_share:.0%} of their points are cut off from all others in height"
    return why, "Mark stray points as noise (class 7 or 18), or raise stray_share in [features] of --config"


_MEASURED: tuple[Measured, Measured] = ("ground points", "ground points (found by the cloth)")
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
    summary = result.summary
    raise TooUnknownError(
        f"{summary.unknown:,} of {summary.tiles:,} tiles are unknown ({outcome.share:.1%}), more than the "
        f"{100.0 * config.max_unknown:g}% that `max_unknown` allows. The layers in {config.out} are complete",
        *([unknown_line(result, config)] if explain else []),
    )
