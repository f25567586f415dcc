"""Fit what needs no drives again, and write it into calibrations: ``python -m bumpymap.lab.simulate.refit FILE...``.

The files are the shipped calibrations if none is named. The terrain library follows from the seed in the file, and the
file holds its drives: ride model and model of thin surveys are fitted to them, and tiles with steps are rated anew.
Class limits and tables stay.
"""

import sys
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

from bumpymap.core import UsageError, atomic
from bumpymap.lab.simulate.plan import read_library
from bumpymap.lab.simulate.ride_fit import fit_ride, fit_thin_surveys
from bumpymap.lab.simulate.steps import rate_steps
from bumpymap.rating import Calibration, Vehicle


def refit(calibration: Calibration) -> Calibration:
    """Return a calibration with newly fitted models of the ride and of thin surveys.

    Raises
    ------
    UsageError
        It holds no drives over the terrain library, or was moved to real drives, which a fit would forget.
    """
    _require_unmoved(calibration)
    if "library" not in calibration.settings:
        raise UsageError(
            f"the calibration {calibration.id} holds no drives over the terrain library. Make one with: "
            "bumpymap calibrate"
        )
    terrains, driven = read_library(calibration)
    profile = Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}")
    return refit_thin(rate_steps(replace(calibration, ride=fit_ride(profile, terrains, driven))))


def refit_thin(calibration: Calibration) -> Calibration:
    """Return a calibration with a newly fitted model of thin surveys.

    Raises
    ------
    UsageError
        It has no ride model, or was moved to real drives.
    """
    _require_unmoved(calibration)
    if calibration.ride is None:
        raise UsageError(f"the calibration {calibration.id} holds no ride model. Make one with: bumpymap calibrate")
    terrains, _ = read_library(calibration)
    profile = Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}")
    return replace(calibration, thin=fit_thin_surveys(profile, terrains, calibration.ride, calibration.class_limits[0]))


def _require_unmoved(calibration: Calibration) -> None:
    """Raise UsageError if a calibration was moved to real drives: what they told is not among the simulated ones."""
    moved = calibration.settings.get("moved_to_drives")
    if moved is not None:
        raise UsageError(
            f"the calibration {calibration.id} was moved to real drives, and a new fit to the simulated ones would "
            f"discard that. Fit the calibration {moved['calibration_id']}, which it was before, and move that again "
            "with: bumpymap check --refit"
        )


if __name__ == "__main__":
    shipped = Path(str(files("bumpymap.rating") / "data" / "calibrations"))
    for path in [Path(name) for name in sys.argv[1:]] or sorted(shipped.glob("*.json")):
        text = refit(Calibration.load(path)).to_json()
        with atomic(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
