"""The map of a drive: the frames, merged by their poses, are mapped like a survey."""

import logging
from collections.abc import Mapping, Sequence
from typing import Any

from pyproj import CRS

from bumpymap.core import Kept, MapConfig, OutputError, Progress, UsageError, parse_crs, what_to_keep
from bumpymap.layers import ACCUMULATED_NAME, MAP_FOLDER, Frame
from bumpymap.rating import find_calibration
from bumpymap.scan.config import ScanConfig
from bumpymap.survey import MapResult, map_surveys

__all__ = ["crs_of_poses", "drive_settings", "map_drive"]

_log = logging.getLogger(__name__)


def crs_of_poses(config: ScanConfig) -> CRS | None:
    """Return the CRS of the poses, None for local coordinates; raise UsageError if its axes are not in metres."""
    if config.crs is None:
        return None
    crs = parse_crs(config.crs)
    if not crs.is_projected or any(axis.unit_conversion_factor != 1.0 for axis in crs.axis_info):
        raise UsageError(f"`crs='{config.crs}'` is {crs.name}; poses are in metres, so give a projected CRS in metres")
    return crs


def drive_settings(config: ScanConfig, frames: Sequence[Frame]) -> MapConfig | None:
    """Return the settings of the map of the drive, None without poses; check its calibration before the long work."""
    if all(frame.pose is None for frame in frames):
        config.refuse_map_settings()
        return None
    own = {"vehicle": config.vehicle} if config.vehicle is not None else {}
    drive = MapConfig(
        surveys=(config.out / ACCUMULATED_NAME,),
        out=config.out / MAP_FOLDER,
        ground="class",
        calibration=config.calibration,
        local=config.crs is None,
        overwrite=config.overwrite,
        resume=config.resume,
        **own,  # type: ignore[arg-type]
    )
    calibration = find_calibration(drive.vehicle, drive.calibration)
    calibration.require_grid(drive.tile_size, drive.pixels)
    return drive


def map_drive(drive: MapConfig, accumulated: Mapping[str, Any], progress: Progress) -> MapResult | None:
    """Map the merged frames; return None if none of their points is ground.

    Parameters
    ----------
    drive : MapConfig
    accumulated : mapping
        Number of merged ``points``, and of those that are ``ground``.
    progress : Progress
    """
    if not accumulated["ground"]:
        _log.warning("no map was made: none of the %d gathered points is ground", accumulated["points"])
        return None
    if drive.out.is_symlink():
        raise OutputError(
            f"{drive.out} is a link and was not touched. Remove it, or pass `overwrite=True` to replace it"
        )
    try:
        return map_surveys(drive, progress)
    except BaseException as end:
        note = "The products of the frames are complete; the map of the drive is missing."
        end.__notes__ = [note + (" Pass `resume=True` to make it." if what_to_keep(end) is not Kept.NOTHING else "")]
        raise
