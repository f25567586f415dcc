"""The terrain library of a calibration: ground of many kinds with a wide range of heights and slopes, and its drives.

A calibration stores the drives, not the ground, which follows from the seed. A ride model can therefore be fitted again
from the file, without driving and with the same bits.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from bumpymap.core import BadInputError
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate.drive import PatchDrives
from bumpymap.lab.simulate.jobs import Key
from bumpymap.lab.terrains import KINDS, Terrain, make_terrain
from bumpymap.rating import Calibration, DrivenTerrain, Vehicle


def calibrated_settings(calibration: Calibration) -> CalibrationSettings:
    """Return the settings of the vehicle, the seed and the tiles that a calibration was made with."""
    return CalibrationSettings(
        Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}"),
        seed=int(calibration.settings.get("seed", 1)),
        tile_size=calibration.tile_size,
        pixels=calibration.pixels,
    )


def library_terrain(settings: CalibrationSettings, kind: str, index: int) -> Terrain:
    """Make a terrain of the library for the vehicle: the height that a wheel climbs is proportional to its radius."""
    return make_terrain(
        kind,
        settings.seed,
        index,
        height_scale=settings.height_scale,
        slope_limit_deg=settings.profile.slope_limit_deg,
        tile_size=settings.tile_size,
        pixels=settings.pixels,
    )


_COLUMNS = tuple(f.name for f in fields(DrivenTerrain) if f.name not in ("kind", "index"))


def driven_library(settings: CalibrationSettings, results: Mapping[Key, PatchDrives]) -> tuple[DrivenTerrain, ...]:
    """Summarise the drives over the library, kind by kind; C_r is rounded to six digits, as in the file."""
    return tuple(
        DrivenTerrain(
            kind=kind,
            index=index,
            c_r=six_digits(drives.mean_c_r),
            c_r_error=six_digits(drives.standard_error),
            completed=len(drives.completed),
            stuck=drives.outcome.count("stuck"),
            rolled=drives.outcome.count("rolled"),
        )
        for kind in KINDS
        for index in range(settings.terrains)
        for drives in (results["library", kind, index],)
    )


def library_record(driven: Sequence[DrivenTerrain]) -> dict[str, dict[str, list[Any]]]:
    """Return the entry of a calibration file: kind -> column -> one value per terrain, ordered by index."""
    record: dict[str, dict[str, list[Any]]] = {}
    for terrain in driven:
        for name in _COLUMNS:
            record.setdefault(terrain.kind, {}).setdefault(name, []).append(getattr(terrain, name))
    return record


def library_terrains(calibration: Calibration) -> tuple[DrivenTerrain, ...]:
    """Read the driven terrains from a calibration; raise BadInputError if the record is damaged."""
    try:
        return tuple(
            DrivenTerrain(kind, index, **dict(zip(_COLUMNS, values, strict=True)))
            for kind, columns in calibration.settings["library"].items()
            for index, values in enumerate(zip(*(columns[name] for name in _COLUMNS), strict=True))
        )
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise BadInputError(
            f"the record of the terrain library in the calibration {calibration.id} is damaged: {error!r}. "
            "Make it again with: bumpymap calibrate --vehicle FILE --out CALIBRATION.json"
        ) from error


def read_library(calibration: Calibration) -> tuple[list[Terrain], tuple[DrivenTerrain, ...]]:
    """Return the ground and the drives of the terrain library of a calibration, the inputs of `fit_ride`."""
    settings, driven = calibrated_settings(calibration), library_terrains(calibration)
    return [library_terrain(settings, terrain.kind, terrain.index) for terrain in driven], driven


def six_digits(value: float | None) -> float | None:
    """Round a figure as it is recorded; None for None and NaN."""
    return None if value is None or math.isnan(value) else float(f"{value:.6g}")
