"""Fit what needs no drives again, and write it into calibrations: ``python -m bumpymap.lab.simulate.refit FILE...``.

The files are the shipped calibrations if none is named. The terrain library follows from the seed in the file.
"""

import sys
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

from bumpymap.core import UsageError
from bumpymap.lab.simulate.library import read_library
from bumpymap.lab.simulate.thin_surveys import fit_thin_surveys
from bumpymap.rating import Calibration, Vehicle

__all__ = ["refit_thin"]


def refit_thin(calibration: Calibration) -> Calibration:
    """Return a calibration with a newly fitted model of thin surveys.

    Raises
    ------
    UsageError
        It has no ride model.
    """
    if calibration.ride is None:
        raise UsageError(f"the calibration {calibration.id} holds no ride model. Make one with: bumpymap calibrate")
    terrains, _ = read_library(calibration)
    profile = Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}")
    return replace(calibration, thin=fit_thin_surveys(profile, terrains, calibration.ride, calibration.class_limits[0]))


if __name__ == "__main__":
    shipped = Path(str(files("bumpymap.rating") / "data" / "calibrations"))
    for path in [Path(name) for name in sys.argv[1:]] or sorted(shipped.glob("*.json")):
        path.write_text(refit_thin(Calibration.load(path)).to_json(), encoding="utf-8")
