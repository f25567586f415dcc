"""How many tiles of a survey are unknown, why, and what would help: in the same words before a run and after it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from bumpymap.core import REASON_TEXT, FeatureSettings, Reason
from bumpytiles import Grid

__all__ = ["Measured", "Outcome", "advise", "enough_points", "models_for", "size_options"]

Measured = Literal["points", "ground points (class 2)", "ground points (found by the cloth)"]
_FEW = 0.1
"""A smaller share of unknown tiles is said, but nothing is advised: every survey has a rim."""
_LARGEST_TILE = 20
"""Tiles beyond this say little about what a wheel meets, m."""
_WITHOUT_HOLES = 1.5
"""With so many times the points that cover enough, density makes few holes: of 4,000 tiles with points at random,
49 % had too many holes with 65 points, 2.4 % with 72, none with 90."""
_SMALL = 16
"""Of so many tiles, 4 x 4, most lie on the rim."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of the tiles of a survey, or will."""

    tiles: int
    """That hold a point."""
    unknown: Mapping[Reason, float]
    """Tiles without a class, by reason."""
    measured: Measured
    """What a run measures."""
    points_per_tile: float
    """Of what is measured: median over the tiles."""
    all_points_per_tile: float
    """All points that count: mean over the tiles."""

    @property
    def share(self) -> float:
        """Share of unknown tiles, 0..1."""
        return sum(self.unknown.values()) / self.tiles if self.tiles else 0.0


def enough_points(grid: Grid, settings: FeatureSettings) -> int:
    """Points from which on a tile can probably be judged.

    Points scattered at random over ``m`` pixels leave a pixel empty with probability ``exp(-n / m)``, so ``n`` points
    cover the share ``1 - exp(-n / m)``.
    """
    for_coverage = -math.log1p(-min(settings.min_coverage, 0.999)) * grid.pixels**2
    return max(settings.min_points, math.ceil(for_coverage))


def advise(outcome: Outcome, grid: Grid, settings: FeatureSettings, *, before_run: bool) -> str:
    """Say in one line which share of the tiles is unknown, why, and what would help; nothing where it is few.

    Parameters
    ----------
    outcome : Outcome
    grid : Grid
        Of its tiles.
    settings : FeatureSettings
        When a tile is unknown.
    foretold : bool
        Before a run, not after it.
    """
    if outcome.share <= _FEW:
        return ""
    most = max(outcome.unknown, key=lambda reason: outcome.unknown[reason])
    head = f"{outcome.share:.0%} of the tiles {'will be' if before_run else 'are'} unknown"
    head = f"about {head}" if before_run else head
    why, help_ = {
        Reason.TOO_MANY_HOLES: _holes,
        Reason.OUTLIER_RELIEF: _outliers,
    }.get(most, _too_few)(outcome, grid, settings)
    return f"{head}, mostly because of {REASON_TEXT[most]}: {why}. {help_}"


def models_for(grid: Grid) -> str:
    """Say how to get what tiles of another size want: a calibration and a network."""
    size = size_options(grid)
    return (
        "a calibration and a texture network made for them: "
        f"bumpymap calibrate {size} --out my.json; bumpymap train {size} --out my.onnx; "
        f"then bumpymap map {size} --calibration my.json --model my.onnx"
    )


def size_options(grid: Grid) -> str:
    """Give the options of a grid that is not the default one; empty for that."""
    size = f"--tile-size {grid.tile_size:g}" if grid.tile_size != Grid().tile_size else ""
    pixels = f"--pixels {grid.pixels}" if grid.pixels != Grid().pixels else ""
    return " ".join(filter(None, (size, pixels)))


def _too_few(outcome: Outcome, grid: Grid, settings: FeatureSettings) -> tuple[str, str]:
    enough = enough_points(grid, settings)
    why = (
        f"{outcome.points_per_tile:.0f} {outcome.measured} per tile (median); at least {settings.min_points} are "
        f"needed, and about {enough} to leave few holes"
    )
    if outcome.measured == "points":
        return why, _larger_tiles(outcome, grid, enough)
    every = f"{outcome.all_points_per_tile:.0f} per tile on average"
    if outcome.all_points_per_tile < enough:
        return why, f"All points (--ground all) are too few as well, {every}. {_larger_tiles(outcome, grid, enough)}"
    return why, _all_points(outcome, every)


def _all_points(outcome: Outcome, every: str) -> str:
    said = f"--ground all measures every point, {every}, vegetation too"
    if outcome.measured == "ground points (class 2)":
        said += "; --ground csf detects ground points where the survey has any"
    return said


def _larger_tiles(outcome: Outcome, grid: Grid, enough: float) -> str:
    """Larger tiles with as many pixels hold more points in each."""
    held = outcome.points_per_tile if outcome.measured == "points" else outcome.all_points_per_tile
    size = math.ceil(grid.tile_size * math.sqrt(enough / max(held, 1.0)))
    if size > _LARGEST_TILE:
        return "The survey is too sparse for this purpose: a denser one is needed"
    larger = Grid(max(size, math.floor(grid.tile_size) + 1), grid.pixels)
    option = size_options(larger) + ("" if outcome.measured == "points" else " --ground all")
    return (
        f"A denser survey would help, or larger tiles: bumpymap info {option} says what they would give; they need "
        f"{models_for(larger)}"
    )


def _holes(outcome: Outcome, grid: Grid, settings: FeatureSettings) -> tuple[str, str]:
    why = (
        f"ground more than {settings.max_hole:g} m from every pixel with a point, or less than "
        f"{settings.min_coverage:.0%} of the pixels with one"
    )
    if outcome.tiles <= _SMALL:
        return why, f"The survey has {outcome.tiles} tiles of {grid.tile_size:g} m, most of them on its rim"
    if outcome.measured != "points" and outcome.all_points_per_tile >= enough_points(grid, settings):
        return why, _all_points(outcome, f"{outcome.all_points_per_tile:.0f} per tile on average")
    without_holes = _WITHOUT_HOLES * enough_points(grid, settings)
    if outcome.points_per_tile < without_holes:
        return why, _larger_tiles(outcome, grid, without_holes)
    return why, "Points from more directions would help, or a larger max_hole in [features] of --config"


def _outliers(outcome: Outcome, grid: Grid, settings: FeatureSettings) -> tuple[str, str]:  # noqa: ARG001
    why = f"more than {settings.stray_share:.0%} of their points are cut off from all others in height"
    return why, "Mark stray points as noise (class 7 or 18), or raise stray_share in [features] of --config"
