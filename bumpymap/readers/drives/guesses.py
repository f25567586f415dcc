"""Units and meanings that only the values of columns tell, and values that cannot be meant."""

import numpy as np

from bumpymap.core import BadInputError, PlaceKind
from bumpymap.readers.drives.quantities import UNITS
from bumpymap.readers.drives.signals import Floats

__all__ = ["check_lonlat", "guess_acceleration", "guess_angle_unit", "guess_local", "refuse_odd_rates"]

_MOST_RATE = 3.0
"""Median angular rate, rad/s: no ground vehicle turns that fast for half of a drive."""
_MOST_PEAK = 20.0
"""99th percentile of angular rates, rad/s."""
_LARGE_M = 1e5
"""No odometry reaches so far, m; eastings and northings do."""


def refuse_odd_rates(rates: Floats, source: str, names: tuple[str, ...], *, known: bool) -> str | None:
    """Refuse angular rates that cannot be rad/s; return a note if their unit is only taken to be rad/s.

    Parameters
    ----------
    rates : (n, 3) float64
        rad/s.
    source : str
        Name of the file.
    names : tuple of str
        Columns.
    known : bool
        Whether the unit was stated.

    Raises
    ------
    BadInputError
        The rates are too large, or all of them are zero.
    """
    with np.errstate(over="ignore"):
        size = np.linalg.norm(rates, axis=1)
    middle, peak = (float(value) for value in np.percentile(size, (50, 99)))
    if not size.any():
        raise BadInputError(
            f"the angular rates of {source} ({', '.join(names)}) are all zero: these columns hold no gyroscope. Name "
            f"those that do: `columns='rate_x=NAME,rate_y=NAME,rate_z=NAME'`"
        )
    if middle > _MOST_RATE or peak > _MOST_PEAK:
        stated = ",".join(f"rate_{axis}={name}[deg/s]" for axis, name in zip("xyz", names, strict=True))
        raise BadInputError(
            f"the angular rates of {source} ({', '.join(names)}) are too large for rad/s: half of them are above "
            f"{middle:.3g}, one in a hundred above {peak:.3g}. State their unit: `columns='{stated}'` (rad/s, deg/s, "
            "mrad/s or mdeg/s)"
        )
    return None if known else f"angular rates of {source} ({', '.join(names)}) name no unit and are taken as rad/s"


def guess_acceleration(values: Floats, source: str, *, known: bool) -> tuple[Floats | None, str | None]:
    """Return accelerations in m/s2, (n, 3), and a note on their unit; None if they hold no gravity.

    Without a stated unit, g and mg are told from the size of gravity.
    """
    middle = float(np.linalg.norm(np.median(values, axis=0)))  # of noise alone it would be small
    units = {"m/s2": 1.0} if known else UNITS["acceleration"]
    for unit, factor in units.items():
        if 7.0 < middle * factor < 13.0:
            note = None if known or unit == "m/s2" else f"accelerations of {source} are taken as {unit}"
            return values * factor, note
    return None, (
        f"accelerations of {source} are not used: their median is {middle:.3g} m/s2, and with gravity it would be "
        "about 9.8"
    )


def guess_angle_unit(angles: Floats, source: str) -> tuple[float, str]:
    """Return the factor from angles, (n, 3), to rad, told from their size, and a note."""
    in_degrees = float(np.abs(angles).max(initial=0.0)) > 2.0 * np.pi + 0.01
    unit = "deg" if in_degrees else "rad"
    return UNITS["angle"][unit], f"roll, pitch and yaw of {source} name no unit and are taken as {unit}"


def check_lonlat(lon: Floats, lat: Floats, source: str, names: tuple[str, ...]) -> tuple[Floats, Floats, str | None]:
    """Return longitude and latitude in degrees; a note if they were whole numbers of 1e-7 degrees.

    Raises
    ------
    BadInputError
        They are out of range, perhaps because they are swapped.
    """
    note = None
    if min(np.median(np.abs(lon)), np.median(np.abs(lat))) > 1e5 and not (lon % 1.0).any() and np.abs(lon).max() > 1e7:
        lon, lat = lon * 1e-7, lat * 1e-7
        note = f"longitude and latitude of {source} are taken as 1e-7 degrees"
    far_lon, far_lat = float(np.abs(lon).max()), float(np.abs(lat).max())
    if far_lat <= 90.0 and far_lon <= 360.0:
        return lon, lat, note
    why = "Longitudes are -180 to 180 degrees, latitudes -90 to 90."
    if far_lat <= 360.0 and far_lon <= 90.0:
        why = f"They seem to be swapped: `columns='longitude={names[1]},latitude={names[0]}'`."
    elif far_lat > 360.0:
        why += " Degrees with minutes (NMEA) are not read. Metres are named so: `columns='easting=NAME,northing=NAME'`"
    raise BadInputError(
        f"the positions of {source} ({', '.join(names)}) reach longitude {far_lon:.6g}, latitude {far_lat:.6g}. {why}"
    )


def guess_local(x: Floats, y: Floats, source: str) -> tuple[PlaceKind, str]:
    """Tell whether columns x and y are of odometry, or eastings and northings."""
    if max(float(np.median(np.abs(x))), float(np.median(np.abs(y)))) > _LARGE_M:
        return "projected", f"x and y of {source} are as large as eastings and northings, and are taken for those"
    return "local", f"x and y of {source} are taken for odometry: they say how far it drove, but not where"
