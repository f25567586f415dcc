"""Choose pairs of a start and a goal, and plan the best way of each."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Progress, TileField
from bumpymap.lab.evaluate.routes.predicted import cut_at_tiles, shared_length, tile_cost
from bumpymap.lab.evaluate.routes.settings import RouteTrialSettings

__all__ = ["PlanWay", "WayPair", "choose_pairs"]

Floats = NDArray[np.float64]
PlanWay = Callable[[Floats, Floats], Floats | None]
"""Plans a way over the map: start and goal (2,) in field coordinates, that is tiles from its north and from its west.
Returns the corners (n, 2) from start to goal, or None if there is no way."""

_MOST_TRIED = 5000


@dataclass(frozen=True, slots=True)
class WayPair:
    """Two ways between the same places, in field coordinates."""

    best: Floats
    """(n, 2) the planned way."""
    straight: Floats
    """(2, 2) the straight line."""

    def lines(self) -> dict[str, Floats]:
        """Return both by name."""
        return {"best": self.best, "straight": self.straight}


def choose_pairs(
    field: TileField, plan: PlanWay, settings: RouteTrialSettings, progress: Progress
) -> list[WayPair]:  # fmt: skip
    """Draw starts and goals at centres of passable tiles between which a way exists.

    A pair is kept if C_r is known along all of the straight line, which may cross barred ground, and if the best way is
    another one. The pairs depend on the map, the planner and the settings only.

    Parameters
    ----------
    field : TileField
        The whole map.
    plan : PlanWay
    settings : RouteTrialSettings
    progress : Progress

    Raises
    ------
    BadInputError
        The map has no such pair.
    """
    cost = tile_cost(field)
    known = np.isfinite(field.c_r)
    found: list[WayPair] = []
    progress.start("planning ways", settings.total_pairs)
    for start, goal in _candidates(np.isfinite(cost), field.grid.tile_size, settings):
        straight = np.stack([start, goal])
        pieces = cut_at_tiles(straight)
        if not known[pieces.row, pieces.col].all():
            continue
        best = plan(start, goal)
        if best is None or shared_length(best, straight) > settings.most_shared:
            continue
        found.append(WayPair(np.asarray(best, np.float64), straight))
        progress.advance(1)
        if len(found) == settings.total_pairs:
            break
    if not found:
        raise BadInputError(
            f"the map has no two passable tiles {settings.least_m:g} to {settings.most_m:g} m apart with a way between "
            "them other than the straight line. Give the layers of a larger survey"
        )
    return found


def _candidates(
    passable: NDArray[np.bool_], tile_size: float, settings: RouteTrialSettings
) -> Iterator[tuple[Floats, Floats]]:
    """Yield random centres of passable tiles that are joined side by side, at the wanted distance."""
    from scipy.ndimage import label

    part, _ = label(passable)
    tiles = np.argwhere(passable)
    rng = np.random.default_rng(settings.seed)
    for _ in range(_MOST_TRIED if len(tiles) else 0):
        first, second = tiles[rng.integers(len(tiles), size=2)]
        metres = float(np.hypot(*(second - first))) * tile_size
        if settings.least_m <= metres <= settings.most_m and part[tuple(first)] == part[tuple(second)]:
            yield first + 0.5, second + 0.5
