"""Trees on the meadows of the synthetic quarry: positions and crown heights."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.worlds.sample import _layout as lay
from bumpymap.lab.worlds.sample._noise import Floats

__all__ = ["Tree", "crown_over", "plant"]

_WANTED = 30


@dataclass(frozen=True, slots=True)
class Tree:
    """One tree; the crown is round seen from above."""

    easting: float
    """m."""
    northing: float
    """m."""
    radius: float
    """Radius of the crown, m."""
    height: float
    """Top above the ground at the trunk, m."""
    is_conifer: bool
    """True: a cone almost down to the ground; False: an ellipsoid on a trunk."""


def plant(
    seed: int, corner: tuple[float, float], may_stand: Callable[[Floats, Floats], NDArray[np.bool_]]
) -> tuple[Tree, ...]:
    """Draw random trees that do not touch each other.

    Parameters
    ----------
    seed : int
        Seed of the site.
    corner : (float, float)
        Easting and northing of the local origin, m.
    may_stand : callable
        Function of local x, y (n,) that is True where a trunk may stand.
    """
    rng = np.random.default_rng((seed, 101))
    candidates = rng.random((400, 2)) * (lay.EAST_WEST, lay.NORTH_SOUTH)
    candidates = candidates[may_stand(candidates[:, 0], candidates[:, 1])]
    chosen: list[Tree] = []
    for x, y in candidates.tolist():
        radius = float(rng.uniform(1.3, 2.7))
        tree = Tree(
            corner[0] + x, corner[1] + y, radius, radius * float(rng.uniform(2.3, 3.2)), bool(rng.random() < 0.4)
        )
        clear = all(
            np.hypot(tree.easting - other.easting, tree.northing - other.northing) > radius + other.radius + 0.5
            for other in chosen
        )
        if clear:
            chosen.append(tree)
        if len(chosen) == _WANTED:
            break
    return tuple(chosen)


def crown_over(trees: Iterable[Tree], easting: Floats, northing: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return top and bottom of the crown above each position.

    Parameters
    ----------
    trees : iterable of Tree
    easting, northing : array (n,) float64
        m.

    Returns
    -------
    top, bottom : array (n,) float64
        m above the ground at the trunk; NaN without a crown.
    tree : array (n,) int64
        Index of the tree; -1 without a crown.
    """
    top, bottom = np.full(easting.shape, np.nan), np.full(easting.shape, np.nan)
    which = np.full(easting.shape, -1, dtype=np.int64)
    for number, tree in enumerate(trees):
        distance = np.hypot(easting - tree.easting, northing - tree.northing) / tree.radius
        under = distance < 1.0
        share = distance[under]
        which[under] = number
        if tree.is_conifer:
            top[under], bottom[under] = tree.height * (1.0 - 0.85 * share), 0.1 * tree.height
        else:
            half = 0.36 * tree.height
            bulge = half * np.sqrt(1.0 - share**2)
            top[under], bottom[under] = tree.height - half + bulge, tree.height - half - bulge
    return top, bottom, which
