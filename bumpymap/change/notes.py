"""What to know of a comparison before its changes are believed."""

from collections.abc import Iterator, Mapping
from typing import Any

from bumpymap.core import count_text

__all__ = ["remarks"]

_DENSITY = 2.0
"""Ratio of the densities from which surveys are unlike."""
_WIDE = 1.5
"""Widening from which the surveys do not fit each other."""
_MOST_CHANGED = 0.3
"""Share of changed tiles from which the rest may be no measure of what has not changed."""
_RIDE = 0.05
"""Median change of the ride cost, as a share, that is told."""


def remarks(fit: Mapping[str, Any], counts: Mapping[str, Any]) -> tuple[str, ...]:
    """Return remarks and warnings, a sentence each."""
    return tuple(_remarks(fit, counts))


def _remarks(fit: Mapping[str, Any], counts: Mapping[str, Any]) -> Iterator[str]:
    if fit["offset_m"] is not None:
        taken = fit["offset_taken_off_m"]
        what = "taken off" if taken == fit["offset_m"] else f"{taken:+.3f} m was taken off, as asked"
        side = "higher" if fit["offset_m"] > 0.0 else "lower"
        lies = f"{abs(fit['offset_m']):.3f} m {side}"
        level = abs(fit["offset_m"]) < 0.0005
        yield f"the later survey lies {'level with the earlier one' if level else lies} in the median tile; {what}"
    low, high = sorted(fit["median_density_m2"])
    if high > _DENSITY * low:
        yield (
            f"the surveys have unlike densities, {low:,.0f} and {high:,.0f} points per m2: a ride cost depends on it a "
            "little, so changes of the ride count less than those of the ground"
        )
    wide = {name: factor for name, factor in fit["widened"].items() if factor > _WIDE}
    if wide:
        told = ", ".join(f"{name} {factor:.1f} times" for name, factor in wide.items())
        yield (
            f"the surveys differ everywhere by more than their noise ({told}), as if they did not fit each other: "
            "spreads were widened, and small changes are not found. Align them to the same control points"
        )
    ratio = fit["median_ratio_c_r"]
    if ratio is not None and abs(ratio - 1.0) > _RIDE:
        yield f"the ride cost of the median tile is {ratio:.2f} times what it was: the surveys may be what differs"
    if counts["changed"] > _MOST_CHANGED * max(counts["compared"], 1):
        yield (
            f"{counts['changed']:,} of {count_text(counts['compared'], 'tile')} have changed: too many for the rest to "
            "tell offset and noise well"
        )
    left = counts["in_both"] - counts["compared"]
    if left:
        yield f"{count_text(left, 'tile has', 'tiles have')} too few pixels in common to be compared"
    if None not in fit["versions"] and fit["versions"][0] != fit["versions"][1]:
        yield f"the layers were made by versions {' and '.join(fit['versions'])}; map both with one"
