"""Positions of a drive in metres, how far they scatter, and where they lie on the grid of a map."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from scipy.ndimage import gaussian_filter, gaussian_filter1d, map_coordinates

from bumpymap.core import BadInputError, DriveLog, Floats, PlaceTrack
from bumpymap.layers import MapReader
from bumpymap.route import extent_text
from bumpytiles import TileWindow

Complexes = NDArray[np.complex128]

_LEAST_PLACES = 20
"""Fewest positions of a drive (chosen)."""
_GAP_S = 2.5
"""Time between positions above which there is a gap, s, or that many of their usual intervals (chosen)."""
_LAG_S = 3.0
"""Time over which wandering errors show, s (chosen)."""
_LEAST_ERROR_M = 0.005
"""Least error of positions that is assumed, m (chosen: no receiver is better)."""
_CORRELATION_S = 60.0
"""Time over which errors of a receiver wander, where it does not say how large they are, s (chosen)."""
_NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


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


def in_order(time: Floats, known: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the rows that are known and have a time, in its order; of equal times the first."""
    order = np.argsort(time, kind="stable")
    order = order[np.isfinite(time[order]) & known[order]]
    return np.asarray(order[np.diff(time[order], prepend=-np.inf) > 0.0])


def metre_places(track: PlaceTrack, easting: Floats, northing: Floats, name: str) -> MetrePlaces:
    """Sort positions by time and leave out what is not a number.

    Raises BadInputError: there are too few.
    """
    place = easting + 1j * northing
    order = in_order(track.time, np.isfinite(place))
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

    ``longitude``, ``latitude`` (m,): WGS 84, degrees.
    """
    middle = CRS.from_dict({"proj": "aeqd", "lon_0": np.nanmedian(longitude), "lat_0": np.nanmedian(latitude)})
    easting, northing = Transformer.from_crs("OGC:CRS84", middle, always_xy=True).transform(longitude, latitude)
    return np.asarray(easting), np.asarray(northing)


def near_place(time: Floats, places: MetrePlaces) -> NDArray[np.bool_]:
    """Return which times have positions on both sides that are not too far apart.

    ``time`` (n,): on the clock of the positions, s.
    """
    after = np.searchsorted(places.time, time, side="right")
    inside = (after > 0) & (after < len(places.time))
    gap = np.diff(places.time, prepend=-np.inf, append=np.inf)
    return np.asarray(inside & (gap[after] <= max(_GAP_S, _GAP_S * float(np.median(np.diff(places.time))))))


def smooth_velocity(places: MetrePlaces, time: Floats, sigma_s: float) -> tuple[Complexes, NDArray[np.bool_]]:
    """Return the velocity by smoothed positions, and where it is known.

    ``time`` (n,): even, on the clock of the positions, s; ``sigma_s``: standard deviation of the Gaussian that smooths,
    s. Returns (n,): m/s.
    """
    step = float(time[1] - time[0])
    rate = np.gradient(np.interp(time, places.time, places.place), step)
    return gaussian_filter1d(rate, sigma_s / step), near_place(time, places)


def scatter_of(places: MetrePlaces, time: Floats, heading: Floats, clock_offset_s: float) -> Scatter:
    """Find how far positions scatter, from the positions themselves.

    Second differences over the shortest interval hold what is new with each position; those over 3 s, across the
    way that the gyroscope tells, hold what wanders. The rate of wandering is measured so; how far it goes is what the
    receiver states, or what 60 s make of that rate.

    ``time``, ``heading`` (n,): heading by the gyroscope on its clock, s, rad; any zero; ``clock_offset_s``: what to add
    to the times of the positions, s.
    """
    near = np.diff(places.place, 2)
    step = float(np.median(np.diff(places.time)))
    even = np.diff(places.time[:-1]) + np.diff(places.time[1:]) < 3.0 * step
    both = np.concatenate([near[even].real, near[even].imag])
    near_var = float((_NORMAL_MAD * np.median(np.abs(both))) ** 2) if len(both) else 0.0
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


def _far_variance(places: MetrePlaces, time: Floats, heading: Floats, offset: float, lag: float) -> float:
    middle = places.time[(places.time > places.time[0] + lag) & (places.time < places.time[-1] - lag)]
    middle = middle[near_place(middle - lag, places) & near_place(middle + lag, places)]
    if len(middle) < 3:
        return 0.0
    at = np.stack([middle - lag, middle, middle + lag])
    place = np.interp(at, places.time, places.place)
    unit = np.cumsum(np.exp(1j * heading)) * (time[1] - time[0])
    way = np.interp(at + offset, time, unit)
    moved, driven = np.diff(place, axis=0), np.diff(way, axis=0)
    turn = (moved[0] + moved[1]) / (driven[0] + driven[1] + 1e-9)
    left = (moved[1] - moved[0]) - turn * (driven[1] - driven[0])
    across = left * np.exp(-1j * np.angle(moved[0] + moved[1]))
    return float((_NORMAL_MAD * np.median(np.abs(across.imag))) ** 2)


_LEAST_INSIDE = 0.02
"""Share of positions in the extent of the map below which a drive was somewhere else (chosen)."""


def places_alone(log: DriveLog) -> MetrePlaces | None:
    """Return the positions of a drive in metres, from any zero; None if it has none."""
    track = log.places
    if track is None:
        return None
    metres = local_metres(track.x, track.y) if track.kind == "lonlat" else (track.x, track.y)
    return metre_places(track, *metres, log.name)


def places_on_map(log: DriveLog, site: MapReader) -> MetrePlaces:
    """Return the positions of a drive on the grid of a map, m.

    Raises BadInputError: there are none, they do not say where on Earth they are, or they lie off the map.
    """
    track = log.places
    if track is None:
        raise BadInputError(
            f"{log.name} has no positions, so it is not known which part of the map was driven. Give the log of the "
            "receiver with it (files of one drive are joined by commas), name its columns with `columns`, or leave "
            "out the layers to measure the drive alone"
        )
    if track.kind == "local":
        raise BadInputError(
            f"{log.name} has positions of odometry alone, which do not say where on the map they are. Give longitude "
            "and latitude or coordinates of the map's CRS, or leave out the layers to measure the drive alone"
        )
    if track.kind == "lonlat" and not site.has_crs:
        raise BadInputError(
            f"{log.name} has longitude and latitude, but the map has no CRS. Map the survey with `crs='EPSG:CODE'`, or "
            "give positions in the survey's own coordinates"
        )
    convert = site.from_lonlat if track.kind == "lonlat" else site.to_grid
    places = metre_places(track, *convert(track.x, track.y), log.name)
    if are_inside(places, site).mean() <= _LEAST_INSIDE:
        x, y = np.nanmedian(track.x), np.nanmedian(track.y)
        where = f"longitude {x:.5f}, latitude {y:.5f}" if track.kind == "lonlat" else f"{x:.1f}, {y:.1f}"
        raise BadInputError(
            f"{log.name} is off the map: the drive lies around {where}; the map spans {extent_text(site)}. Check that "
            "it is the drive of this site, in the CRS of the map or in longitude and latitude, and that these are not "
            "exchanged"
        )
    return places


def are_inside(places: MetrePlaces, site: MapReader) -> NDArray[np.bool_]:
    """Return which positions lie in the extent of the map, (m,)."""
    bounds, east, north = site.grid.window_bounds(site.window), places.place.real, places.place.imag
    return np.asarray((bounds.west <= east) & (east < bounds.east) & (bounds.south <= north) & (north < bounds.north))


_PIXELS, _MOST_PIXELS = 5, 4000
"""Heights along a tile (0.6 m at the usual size, finer than a vehicle is long), and along a side of a window, most."""
_SPREAD_M = 0.6
"""Standard deviation of the Gaussian that smooths heights, m: what four wheels average."""
_LEAST_KNOWN = 0.5
"""Least weight of known heights under that Gaussian (chosen)."""
SlopeAt = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
"""Easting, northing [m on the grid] and course [rad, east 0], (n,) each -> rise of the ground ahead and to the left
over a metre, (n,) each; NaN where it is not known."""


def read_slopes(site: MapReader, window: TileWindow) -> SlopeAt:
    """Read the heights of a window, and take their slopes."""
    size = site.grid.tile_size
    each = min(_PIXELS, max(_MOST_PIXELS // max(window.rows, window.cols), 1))
    height = site.relief(window, (window.rows * each, window.cols * each)).astype(np.float64)
    pixel = size / each
    known = np.isfinite(height)
    middle = float(np.median(height[known])) if known.any() else 0.0
    sigma = _SPREAD_M / pixel
    weight = gaussian_filter(known.astype(np.float64), sigma)
    smooth = gaussian_filter(np.where(known, height - middle, 0.0), sigma) / np.maximum(weight, 1e-9)
    smooth[weight < _LEAST_KNOWN] = np.nan
    down, across = np.gradient(smooth, pixel) if min(smooth.shape) > 1 else (smooth * np.nan, smooth * np.nan)
    west, top = window.col * size, (window.row + window.rows) * size

    def slope_at(easting: Floats, northing: Floats, course: Floats) -> tuple[Floats, Floats]:
        at = np.stack([(top - northing) / pixel - 0.5, (easting - west) / pixel - 0.5])
        east, north = (map_coordinates(slopes, at, order=1, cval=np.nan) for slopes in (across, -down))
        cosine, sine = np.cos(course), np.sin(course)
        return east * cosine + north * sine, north * cosine - east * sine

    return slope_at


def window_around(site: MapReader, easting: Floats, northing: Floats, margin_m: float) -> TileWindow:
    """Return the window of the map's tiles around some places, m; it does not extend beyond the map."""
    whole, ends = site.window, []
    for values, first, count in ((easting, whole.col, whole.cols), (northing, whole.row, whole.rows)):
        edges = site.grid.index(np.array([values.min() - margin_m, values.max() + margin_m]))
        ends.append(np.clip(edges, first, first + count - 1))
    return TileWindow.around(*ends)
