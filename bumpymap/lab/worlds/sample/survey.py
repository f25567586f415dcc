"""The drone survey of the synthetic quarry: overlapping flight lines of zigzag sweeps, noise, crowns, errors.

Points are in the order of flight. All random numbers are drawn before points are dropped, so the survey of a smaller
area contains the same ground points as that part of the whole survey.
"""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.worlds.sample._noise import Floats
from bumpymap.lab.worlds.sample._trees import crown_over
from bumpymap.lab.worlds.sample.site import QuarrySite
from bumpytiles import Bounds

__all__ = ["NOISE_SIGMA", "SCALE", "STRAYS", "SurveyPoints", "sample_survey"]

SCALE = 0.001
"""Coordinates are whole millimetres."""
NOISE_SIGMA = 0.008
"""Standard deviation of the normal noise of ground heights, m. Horizontal positions have no noise."""
STRAYS = 8
"""Number of unflagged outliers, tens of metres above (5) or below (3) the ground."""
NOISE_POINTS = 60
"""Number of points of class 7, metres off the ground."""
WITHHELD_POINTS = 40
"""Number of points with the withheld flag, decimetres to metres off the ground."""

_LINES = 6
_HALF_SWATH = 13.0
_FLIGHT_HEIGHT = 40.0
_CANOPY_SHARE = 0.7
_PULSE_SECONDS = 1e-5
_FEWEST = 1000
UNASSIGNED, GROUND, TREE, NOISE = 1, 2, 5, 7


@dataclass(frozen=True, slots=True)
class SurveyPoints:
    """A survey, one row per point, in the order of flight."""

    easting: NDArray[np.float64]
    """(n,) m, on the millimetre steps of the file."""
    northing: NDArray[np.float64]
    """(n,) m."""
    upward: NDArray[np.float64]
    """(n,) m."""
    classification: NDArray[np.uint8]
    """(n,) LAS class: 1 unassigned, 2 ground, 5 tree, 7 noise."""
    withheld: NDArray[np.bool_]
    """(n,) True if the point must not be used."""
    is_stray: NDArray[np.bool_]
    """(n,) True if the height is far off although the file does not flag the point."""
    line: NDArray[np.uint16]
    """(n,) flight line, from 1."""
    gps_time: NDArray[np.float64]
    """(n,) s since the first pulse."""

    @property
    def is_true_ground(self) -> NDArray[np.bool_]:
        """(n,) True if the height is that of the relief, within the noise."""
        usable: NDArray[np.bool_] = (self.classification == GROUND) & ~self.withheld & ~self.is_stray
        return usable

    def select(self, keep: NDArray[np.bool_]) -> Self:
        """Return the points for which ``keep`` (n,) is True."""
        return replace(self, **{f.name: getattr(self, f.name)[keep] for f in fields(self)})


def sample_survey(site: QuarrySite, density: float = 100.0, area: Bounds | None = None) -> SurveyPoints:
    """Simulate a survey flight over the site.

    Parameters
    ----------
    site : QuarrySite
    density : float
        Mean points per square metre of the whole site; it varies from place to place by a factor of about three.
    area : Bounds, optional
        Keep only this part, m.

    Returns
    -------
    SurveyPoints

    Raises
    ------
    ValueError
        Fewer than 1000 points would be left.
    """
    if not (np.isfinite(density) and density > 0.0):
        raise ValueError(f"density is {density}; it must be a positive number of points per square metre")
    lines = [_fly_line(site, number, density, area or site.bounds) for number in range(_LINES)]
    points = SurveyPoints(*(np.concatenate([getattr(line, f.name) for line in lines]) for f in fields(SurveyPoints)))
    if points.easting.size < _FEWEST:
        raise ValueError(
            f"{points.easting.size} points at {density:g} per square metre; a survey needs {_FEWEST}: "
            "raise the density or widen the area"
        )
    return _add_errors(points, site.seed)


def _fly_line(site: QuarrySite, number: int, density: float, area: Bounds) -> SurveyPoints:
    """Return the points of one flight line inside the area."""
    rng = np.random.default_rng((site.seed, 200 + number))
    easting, northing, pulse = _sweep(rng, site.bounds, number, density)
    ground_noise = NOISE_SIGMA * rng.standard_normal(easting.size)
    crown_draw, crown_depth = rng.random(easting.size), rng.exponential(0.5, easting.size)
    easting, northing = _quantised(easting, site.bounds.west), _quantised(northing, site.bounds.south)
    keep = (easting >= area.west) & (easting < area.east) & (northing >= area.south) & (northing < area.north)
    keep &= ~site.is_water(easting, northing) & (rng.random(easting.size) > 0.01)
    easting, northing = easting[keep], northing[keep]
    canopy, is_tree = _canopy(site, easting, northing, crown_draw[keep], crown_depth[keep])
    upward = np.where(is_tree, canopy, site.height(easting, northing) + ground_noise[keep])
    none = np.zeros(easting.size, dtype=np.bool_)
    return SurveyPoints(
        easting=easting,
        northing=northing,
        upward=_quantised(upward, 0.0),
        classification=np.where(is_tree, TREE, GROUND).astype(np.uint8),
        withheld=none,
        is_stray=none,
        line=np.full(easting.size, number + 1, dtype=np.uint16),
        gps_time=(60.0 * number + _PULSE_SECONDS * pulse[keep]).astype(np.float64),
    )


def _sweep(
    rng: np.random.Generator, box: Bounds, number: int, density: float
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return the positions at which the pulses of a line hit the ground inside the site, in the order of the pulses.

    The drone's speed varies by a quarter, it rolls a little, and its start and end points vary; odd lines fly west.
    """
    width, pitch = box.east - box.west, (box.north - box.south) / _LINES
    swept = 2.0 * _HALF_SWATH * _LINES - 2.0 * (_HALF_SWATH - pitch / 2.0)
    spacing = 1.0 / np.sqrt(density * (box.north - box.south) / swept)
    sweeps, pulses = int(width / spacing), int(2.0 * _HALF_SWATH / spacing)
    pulse = np.arange(sweeps * pulses)
    sweep, within = np.divmod(pulse, pulses)
    along = pulse / pulses * spacing
    along = along + 1.5 * np.sin(2.0 * np.pi * (along / 40.0 + rng.random()))
    angle = np.arctan(_HALF_SWATH / _FLIGHT_HEIGHT) * (2.0 * (within + 0.5) / pulses - 1.0) * (1 - 2 * (sweep % 2))
    roll = np.radians(0.6) * np.sin(2.0 * np.pi * (along / 23.0 + rng.random()))
    x = along + 0.25 * spacing * rng.standard_normal(pulse.size)
    y = pitch * (number + 0.5) + _FLIGHT_HEIGHT * np.tan(angle + roll)
    y += 0.25 * spacing * rng.standard_normal(pulse.size)
    start, end = 1.5 * rng.random(2) * (1.0, -1.0) + (0.0, width)
    inside = (x >= start) & (x < end) & (y >= 0.0) & (y < box.north - box.south)
    if number % 2:
        x = width - x
    return box.west + x[inside], box.south + y[inside], pulse[inside]


def _canopy(
    site: QuarrySite, easting: Floats, northing: Floats, draw: Floats, depth: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return heights of crown points (n,) m, and True (n,) for pulses that stop in a crown."""
    top, bottom, tree = crown_over(site.trees, easting, northing)
    is_tree = (tree >= 0) & (draw < _CANOPY_SHARE)
    trunk = np.array([(t.easting, t.northing) for t in site.trees])
    foot = site.height(trunk[:, 0], trunk[:, 1])
    return foot[tree] + np.maximum(top - depth, bottom), is_tree


def _add_errors(points: SurveyPoints, seed: int) -> SurveyPoints:
    """Move some ground points off the ground: unflagged outliers, class 7, withheld."""
    rng = np.random.default_rng((seed, 300))
    ground = np.flatnonzero(points.classification == GROUND)
    chosen = rng.choice(ground, STRAYS + NOISE_POINTS + WITHHELD_POINTS, replace=False)
    stray, noise, withheld = np.split(chosen, (STRAYS, STRAYS + NOISE_POINTS))
    upward, classification = points.upward.copy(), points.classification.copy()
    is_stray, is_withheld = points.is_stray.copy(), points.withheld.copy()
    upward[stray[:5]] += rng.uniform(18.0, 60.0, 5)
    upward[stray[5:]] -= rng.uniform(12.0, 40.0, STRAYS - 5)
    classification[stray[::2]] = UNASSIGNED
    is_stray[stray] = True
    upward[noise] += rng.uniform(3.0, 25.0, noise.size) * rng.choice((-1.0, 1.0), noise.size)
    classification[noise] = NOISE
    upward[withheld] += rng.uniform(0.3, 3.0, withheld.size) * rng.choice((-1.0, 1.0), withheld.size)
    is_withheld[withheld] = True
    return replace(
        points,
        upward=_quantised(upward, 0.0),
        classification=classification,
        is_stray=is_stray,
        withheld=is_withheld,
    )


def _quantised(value: Floats, origin: float) -> Floats:
    """Round to the file's resolution and return the exact float that a reader of the file computes."""
    return np.rint((value - origin) / SCALE) * SCALE + origin
