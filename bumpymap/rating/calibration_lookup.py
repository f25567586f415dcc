"""Find the calibration of a vehicle, by the same rules in every command."""

import shlex
from pathlib import Path

from bumpymap.core import BadInputError
from bumpymap.rating.calibration import Calibration, shipped_calibrations
from bumpymap.rating.vehicle_profile import Vehicle, load_profile

__all__ = ["calibration_beside", "find_calibration"]


def find_calibration(vehicle: str | Path, file: Path | None = None) -> Calibration:
    """Find the calibration of a vehicle.

    Parameters
    ----------
    vehicle : str or Path
        Name of an included vehicle, or a TOML file, whose calibration is the JSON file of the same name beside it. If
        there is none and the profile equals that of an included vehicle, the calibration of that is used. Name,
        description and weights are those of the TOML file.
    file : Path, optional
        A calibration file; ``vehicle`` is then ignored.

    Raises
    ------
    UsageError
        There is no vehicle of that name, or no such file.
    BadInputError
        The profile or the calibration cannot be read, or they are of different vehicles.
    """
    if file is not None:
        return _checked(Calibration.load(file), str(file))
    profile = load_profile(vehicle)
    if str(vehicle) in shipped_calibrations():
        return Calibration.shipped(str(vehicle))
    path = Path(vehicle)
    beside = calibration_beside(path)
    again = f"bumpymap calibrate --vehicle {shlex.quote(str(path))} --out {shlex.quote(str(beside))}"
    if beside.exists():
        calibration = _checked(Calibration.load(beside), str(beside))
        try:
            return calibration.with_preferences(profile.to_dict(), str(beside))
        except BadInputError as error:
            raise BadInputError(f"{error}. Calibrate for the vehicle of {path}: {again} --overwrite") from error
    for name in shipped_calibrations():
        try:
            return Calibration.shipped(name).with_preferences(profile.to_dict(), name)
        except BadInputError:  # another vehicle
            continue
    raise BadInputError(
        f"there is no calibration of {path}: {beside} does not exist. Make it: {again} (--quick makes a rough one)"
    )


def calibration_beside(profile: Path) -> Path:
    """Return the path of the calibration file that belongs to a TOML file."""
    return profile.with_suffix(".json")


def _checked(calibration: Calibration, origin: str) -> Calibration:
    """Check the stored vehicle like a profile before it is used."""
    Vehicle.from_dict(calibration.vehicle, f"{origin}, vehicle")
    return calibration
