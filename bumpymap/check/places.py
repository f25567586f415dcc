"""Positions of a drive in metres, and how far they scatter."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from bumpymap.core import BadInputError, PlaceTrack

__all__ = ["MetrePlaces", "local_metres", "metre_places", "scatter_of", "smooth_velocity"]

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_LEAST_PLACES = 20
_GAP_S = 2.5
"""Positions further apart than this leave a hole."""
_LAG_S = 3.0
_LEAST_ERROR_M = 0.005
_CORRELATION_S = 60.0
"""Time over which errors of a receiver wander, where it does not say how large they are."""
_NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
_EQUATOR_M, _ECCENTRICITY2 = 6378137.0, 0.00669437999014
"""WGS 84."""


@dataclass(frozen=True, slots=True)
class MetrePlaces:
    """Positions in metres, as east + i north, on their own clock."""

    time: Floats
    """(m,) s, strictly increasing."""
    place: Complexes
    """(m,) m."""
    error: float
    """Median of the standard deviations that the receiver states, m; NaN where it states none."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """Errors of positions: one part is new with each position, the other wanders."""

    white_m: float
    """Standard deviation of the first part along one axis, m."""
    wander_m: float
    """Standard deviation of the second along one axis, m."""
    correlation_s: float
    """Time over which it wanders."""

    @property
    def total_m(self) -> float:
        """Standard deviation along one axis, m."""
        return float(np.hypot(self.white_m, self.wander_m))


def metre_places(track: PlaceTrack, easting: Floats, northing: Floats, name: str) -> MetrePlaces:
    """Sort positions by time and leave out what is not a number.

    Raises
    ------
    BadInputError
        There are too few.
    """
    place = easting + 1j * northing
    order = np.argsort(track.time, kind="stable")
    order = order[np.isfinite(track.time[order]) & np.isfinite(place[order])]
    order = order[np.diff(track.time[order], prepend=-np.inf) > 0.0]
    if len(order) < _LEAST_PLACES:
        raise BadInputError(
            f"{name} has {len(order)} usable positions; a drive needs at least {_LEAST_PLACES}. Did the receiver have "
            "a fix? Give a longer record"
        )
    stated = track.error[order]
    known = stated[np.isfinite(stated) & (stated > 0.0)]
    error = float(np.median(known)) if len(known) else float("nan")
    return MetrePlaces(track.time[order], place[order], error)


def local_metres(longitude: Floats, latitude: Floats) -> tuple[Floats, Floats]:
    """Return metres east and north of the middle of all positions, right to 1e-4 within 10 km of it.

    Parameters
    ----------
    longitude, latitude : float64 arrays (m,)
        WGS 84, degrees.
    """
    lon, lat = np.radians(longitude), np.radians(latitude)
    lon_0, lat_0 = np.nanmedian(lon), np.nanmedian(lat)
    w = 1.0 - _ECCENTRICITY2 * np.sin(lat_0) ** 2
    meridian, normal = _EQUATOR_M * (1.0 - _ECCENTRICITY2) / w**1.5, _EQUATOR_M / np.sqrt(w)
    return (lon - lon_0) * normal * np.cos(lat_0), (lat - lat_0) * meridian


def near_place(time: Floats, places: MetrePlaces) -> NDArray[np.bool_]:
    """Return which times have positions on both sides that are not too far apart.

    Parameters
    ----------
    time : float64 array (n,)
        On the clock of the positions, s.
    """
    after = np.searchsorted(places.time, time, side="right")
    inside = (after > 0) & (after < len(places.time))
    gap = np.diff(places.time, prepend=-np.inf, append=np.inf)
    return np.asarray(inside & (gap[after] <= max(_GAP_S, 2.5 * float(np.median(np.diff(places.time))))))


def smooth_velocity(places: MetrePlaces, time: Floats, sigma_s: float) -> tuple[Complexes, NDArray[np.bool_]]:
    """Return the velocity by smoothed positions, and where it is known.

    Parameters
    ----------
    time : float64 array (n,)
        Even, on the clock of the positions, s.
    sigma_s : float
        Standard deviation of the Gaussian that smooths, s.

    Returns
    -------
    complex128 array (n,)
        m/s.
    bool array (n,)
    """
    step = float(time[1] - time[0])
    even = np.interp(time, places.time, places.place.real) + 1j * np.interp(time, places.time, places.place.imag)
    rate = np.gradient(even, step)
    sigma = sigma_s / step
    smooth = gaussian_filter1d(rate.real, sigma) + 1j * gaussian_filter1d(rate.imag, sigma)
    return smooth, near_place(time, places)


def scatter_of(places: MetrePlaces, time: Floats, heading: Floats, clock_offset_s: float) -> Scatter:
    """Find how far positions scatter, from the positions themselves.

    Second differences over the shortest interval hold what is new with each position; those over 3 s, across the
    way that the gyroscope tells, hold what wanders. The rate of wandering is measured so; how far it goes is what the
    receiver states, or what 60 s make of that rate.

    Parameters
    ----------
    places : MetrePlaces
    time, heading : float64 arrays (n,)
        Heading by the gyroscope on its clock, s, rad; any zero.
    clock_offset_s : float
        What to add to the times of the positions, s.
    """
    near = np.diff(places.place, 2)
    step = float(np.median(np.diff(places.time)))
    even = np.diff(places.time[:-1]) + np.diff(places.time[1:]) < 3.0 * step
    near_var = _variance(near[even])
    lag = max(_LAG_S, 2.0 * step)
    far_var = _far_variance(places, time, heading, clock_offset_s, lag)
    # near = 6 white^2 + 2 rate step; far = 6 white^2 + 2 rate lag
    rate = max(far_var - near_var, 0.0) / (2.0 * (lag - step))
    white = max(np.sqrt(max(near_var - 2.0 * rate * step, 0.0) / 6.0), _LEAST_ERROR_M)
    wander = max(np.sqrt(0.5 * rate * _CORRELATION_S), _LEAST_ERROR_M)
    if np.isfinite(places.error):
        wander = max(wander, np.sqrt(max(places.error**2 - white**2, 0.0)))
    least_rate = 2.0 * wander**2 / 3600.0
    return Scatter(float(white), float(wander), float(2.0 * wander**2 / max(rate, least_rate)))


def _variance(values: Complexes) -> float:
    """Return the variance along one axis, outliers left out."""
    both = np.concatenate([values.real, values.imag])
    return float((_NORMAL_MAD * np.median(np.abs(both))) ** 2) if len(both) else 0.0


def _far_variance(places: MetrePlaces, time: Floats, heading: Floats, offset: float, lag: float) -> float:
    middle = places.time[(places.time > places.time[0] + lag) & (places.time < places.time[-1] - lag)]
    middle = middle[near_place(middle - lag, places) & near_place(middle + lag, places)]
    if len(middle) < 3:
        return 0.0
    at = np.stack([middle - lag, middle, middle + lag])
    place = np.interp(at, places.time, places.place.real) + 1j * np.interp(at, places.time, places.place.imag)
    unit = np.cumsum(np.exp(1j * heading)) * (time[1] - time[0])
    way = np.interp(at + offset, time, unit.real) + 1j * np.interp(at + offset, time, unit.imag)
    moved, driven = np.diff(place, axis=0), np.diff(way, axis=0)
    turn = (moved[0] + moved[1]) / (driven[0] + driven[1] + 1e-9)
    left = (moved[1] - moved[0]) - turn * (driven[1] - driven[0])
    across = left * np.exp(-1j * np.angle(moved[0] + moved[1]))
    return float((_NORMAL_MAD * np.median(np.abs(across.imag))) ** 2)
