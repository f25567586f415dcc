"""Remarks and warnings of a check, in words."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.check.drive_measure import COUNTS, LEFT_OUT, DriveMeasure, WayStretch
from bumpymap.check.settings import LEAST_WINDOW_M
from bumpymap.core import BadInputError, CheckedMap, MapAgreement

__all__ = ["drive_warnings", "left_out", "map_warnings", "refuse_without_stretches"]

_OTHER_SPEED = 0.2
_OTHER_VEHICLE = 1.5
"""A map that is off by more than this factor in the median was made for another vehicle, or of other ground."""
_LITTLE_WAY_M = 50.0
_TILE_M = 3.0
_SHORT = "too short between the parts left out"


def left_out(drive: DriveMeasure, cut: WayStretch) -> dict[str, float]:
    """Return the length that does not count by reason, m; without reasons that take nothing."""
    way = np.abs(drive.speed) / drive.hertz
    reason = np.where((drive.reason == COUNTS) & (cut.label < 0), LEFT_OUT.index(_SHORT), drive.reason)
    length = np.bincount(reason, way, minlength=len(LEFT_OUT))
    return {name: float(metres) for name, metres in zip(LEFT_OUT, length, strict=True) if name and metres > 0.05}


def refuse_without_stretches(drive: DriveMeasure, cut: WayStretch) -> None:
    """Refuse a drive that leaves no stretch.

    Raises
    ------
    BadInputError
        The message says where the way went.
    """
    if len(cut.start_s):
        return
    lost = ", ".join(f"{name} {metres:.0f} m" for name, metres in left_out(drive, cut).items())
    length = float((np.abs(drive.speed) / drive.hertz).sum())
    raise BadInputError(
        f"{drive.name}: no stretch of {LEAST_WINDOW_M:g} m or more is left of {length:.0f} m of way: {lost}. "
        "Drive straight on for at least 10 m at a time, over ground that the map knows"
    )


def drive_warnings(drive: DriveMeasure, cut: WayStretch, *, has_positions: bool) -> list[str]:
    """Return what makes the readings of a drive less sure."""
    found = []
    if np.isnan(drive.floor_radps):
        found.append(
            f"{drive.name}: the vehicle never stands still, so what sensor and engine alone read is not known and not "
            "taken off; C_r of smooth ground may read high. Let it stand for 10 s with its engine on before the drive"
        )
    elif (share := _median_share(drive, cut)) > 0.5:
        found.append(
            f"{drive.name}: sensor and engine alone read {share:.0%} of what was recorded on the way, so C_r is unsure"
        )
    if has_positions and np.isnan(drive.clock_offset_s):
        found.append(
            f"{drive.name}: the offset of the clocks of IMU and positions cannot be told; "
            f"{drive.track.offset_s:+.2f} s is used. Turns, starts and stops on the way tell it"
        )
    if has_positions and drive.track.scatter.total_m > 0.5 * _TILE_M:
        found.append(
            f"{drive.name}: positions are off by {drive.track.scatter.total_m:.1f} m, about as much as a tile is wide, "
            "so readings of single tiles are blurred"
        )
    if cut.way_m.sum() < _LITTLE_WAY_M:
        found.append(f"{drive.name}: only {cut.way_m.sum():.0f} m count, too little to judge a map by")
    return found


def _median_share(drive: DriveMeasure, cut: WayStretch) -> float:
    """Return the median share of the floor in what was read."""
    floor: NDArray[np.float64] = drive.floor / np.maximum(cut.speed_mps, 1e-9)
    return float(np.median(floor / np.maximum(np.hypot(cut.measured, floor), 1e-9)))


def map_warnings(ground: CheckedMap, speeds: list[tuple[str, float]], agreement: MapAgreement) -> list[str]:
    """Return where drives and the vehicle profile of a map do not fit.

    Parameters
    ----------
    ground : CheckedMap
    speeds : list of (str, float)
        Name and median speed of each drive, m/s.
    agreement : MapAgreement
    """
    found = [
        f"{name} was driven at {speed:.2f} m/s and the map is made for {ground.speed_mps:g} m/s; C_r "
        f"changes with speed. Drive at {ground.speed_mps:g} m/s, or map the survey with `speed={speed:.2g}`"
        for name, speed in speeds
        if abs(speed / ground.speed_mps - 1.0) > _OTHER_SPEED
    ]
    ratio = agreement.median_ratio
    if agreement.stretches and not 1.0 / _OTHER_VEHICLE < ratio < _OTHER_VEHICLE:
        found.append(
            f"the map reads {ratio:.2g} times what was measured. Was the vehicle a {ground.vehicle}, as the map "
            "assumes, and has the ground stayed as it was surveyed?"
        )
    return found
