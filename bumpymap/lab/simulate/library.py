"""The drives over the terrain library: write them to a calibration, read them back and regenerate their ground.

A calibration stores the drives, not the ground, which follows from the seed. A ride model can therefore be fitted
again from the file, without driving and with the same bits.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any, Protocol

from bumpymap.core import BadInputError
from bumpymap.lab.simulate.journal import Key
from bumpymap.lab.simulate.patch import PatchDrives
from bumpymap.lab.simulate.plan import CalibrationSettings, calibrated_settings, library_terrain
from bumpymap.lab.worlds import KINDS, Terrain
from bumpymap.rating import Calibration, DrivenTerrain, Vehicle

__all__ = [
    "FitRide",
    "FitThin",
    "driven_library",
    "library_ground",
    "library_record",
    "library_terrains",
    "read_library",
]

_COLUMNS = tuple(f.name for f in fields(DrivenTerrain) if f.name not in ("kind", "index"))


class FitRide(Protocol):
    """Fits a ride model to driven terrains."""

    def __call__(
        self, profile: Vehicle, terrains: Sequence[Terrain], driven: Sequence[DrivenTerrain]
    ) -> dict[str, Any]:
        """Fit a ride model.

        Parameters
        ----------
        profile : Vehicle
        terrains : sequence, length n
            The driven ground.
        driven : sequence, length n
            Results of the drives over it.

        Returns
        -------
        dict
            Plain JSON for the calibration's ``ride`` entry.
        """


class FitThin(Protocol):
    """Fits a model of thin surveys to a ride model."""

    def __call__(
        self, profile: Vehicle, terrains: Sequence[Terrain], ride: dict[str, Any], first_limit: float
    ) -> dict[str, Any]:
        """Fit; see `bumpymap.lab.simulate.thin_surveys.fit_thin_surveys`."""


def driven_library(settings: CalibrationSettings, results: Mapping[Key, PatchDrives]) -> tuple[DrivenTerrain, ...]:
    """Summarise the drives over the library, kind by kind; C_r is rounded to six digits, as in the file."""
    return tuple(
        _driven(kind, index, results["library", kind, index]) for kind in KINDS for index in range(settings.terrains)
    )


def library_ground(settings: CalibrationSettings, driven: Sequence[DrivenTerrain]) -> list[Terrain]:
    """Regenerate the ground of driven terrains."""
    return [library_terrain(settings, terrain.kind, terrain.index) for terrain in driven]


def library_record(driven: Sequence[DrivenTerrain]) -> dict[str, dict[str, list[Any]]]:
    """Return the entry of a calibration file: kind -> column -> one value per terrain, ordered by index."""
    record: dict[str, dict[str, list[Any]]] = {}
    for terrain in driven:
        columns = record.setdefault(terrain.kind, {name: [] for name in _COLUMNS})
        values = asdict(terrain)
        for name, column in columns.items():
            column.append(values[name])
    return record


def library_terrains(calibration: Calibration) -> tuple[DrivenTerrain, ...]:
    """Read the driven terrains from a calibration.

    Raises
    ------
    BadInputError
        The record is damaged.
    """
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
    """Return the ground and the drives of the terrain library of a calibration, the inputs of `FitRide`.

    Raises
    ------
    BadInputError
        The record is damaged.
    """
    driven = library_terrains(calibration)
    return library_ground(calibrated_settings(calibration), driven), driven


def _driven(kind: str, index: int, drives: PatchDrives) -> DrivenTerrain:
    return DrivenTerrain(
        kind=kind,
        index=index,
        c_r=_six_digits(drives.mean_c_r),
        c_r_error=_six_digits(drives.standard_error),
        completed=len(drives.completed),
        stuck=drives.outcome.count("stuck"),
        rolled=drives.outcome.count("rolled"),
    )


def _six_digits(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")
