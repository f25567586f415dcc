"""Stray points: a bird, a multipath echo, a hole in the reading."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.patches.kernels.lanes import extremes, set_all
from bumpytiles import helper

__all__ = ["stray_bounds"]

Floats = NDArray[np.float64]


@helper
def _no_strays(distance: Floats, low: float, high: float, gap: float, most: int) -> bool:
    """Whether it is plain that ``stray_bounds`` finds none (low and high are the extremes of the distances).

    The gap beside a stray is wider than ``gap`` and than the spread of all that stays. So what stays reaches neither
    from the lowest third of the range into the highest, nor from one end of the range into the third at the other
    end; one of the outer thirds then holds strays alone, at most ``most``.
    """
    if high - low <= gap:
        return True
    third = (high - low) / 3.0
    above = below = 0
    for i in range(len(distance)):
        above += distance[i] > high - third
        below += distance[i] < low + third
    return above > most and below > most


@helper
def stray_bounds(distance: Floats, gap: float, most: int, ends: Floats) -> tuple[float, float, int]:
    """Split off stray points: at most ``most`` on one side of a tile, cut off from all others by a wide gap.

    The gap must be wider than ``gap`` metres and wider than the spread of everything that stays: a rock or a tree has
    points at all its heights, a bird or a multipath echo has not. ``ends`` is scratch, (2, most + 1).

    Returns
    -------
    low, high : float
        Points with ``low <= distance <= high`` stay (m).
    strays : int
        Number of points outside.
    """
    n = len(distance)
    if n < 2 * most + 2:
        return -np.inf, np.inf, 0
    least, greatest = extremes(distance)
    if _no_strays(distance, least, greatest, gap, most):
        return -np.inf, np.inf, 0
    top, bottom = ends[0], ends[1]
    set_all(top, -np.inf)
    set_all(bottom, np.inf)
    for i in range(n):
        d = distance[i]
        if d > top[most]:
            k = most
            while k > 0 and top[k - 1] < d:
                top[k] = top[k - 1]
                k -= 1
            top[k] = d
        if d < bottom[most]:
            k = most
            while k > 0 and bottom[k - 1] > d:
                bottom[k] = bottom[k - 1]
                k -= 1
            bottom[k] = d
    # Try the removal of t points above and b below; take the largest that leaves both cuts wide enough.
    best_t = best_b = 0
    for total in range(2 * most, 0, -1):
        for t in range(max(0, total - most), min(most, total) + 1):
            b = total - t
            need = max(gap, top[t] - bottom[b])
            if (t == 0 or top[t - 1] - top[t] > need) and (b == 0 or bottom[b] - bottom[b - 1] > need):
                best_t, best_b = t, b
                break
        if best_t + best_b > 0:
            break
    low = bottom[best_b] if best_b > 0 else -np.inf
    high = top[best_t] if best_t > 0 else np.inf
    return low, high, best_t + best_b
