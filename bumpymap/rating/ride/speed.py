"""Other speeds: the calibration at the speed of a map, and what a vehicle feels at several, as factors on its C_r.

A calibration remembers the speed of a map in its ``motion``, so that everything that is made from it (tiles, thin
tiles, steps) and its ``id`` follow that speed. What the drives of the calibration measured stays theirs: p_fail.

Two quantities are predicted for each speed, all as logarithms over the C_r at the profile's own speed, because what
is uncertain about a tile (noise, tyres, ground finer than a pixel) then cancels:

- c_r: linear in the geometric ratio of both speeds and in s, the logarithm of the speed over the profile's, with terms
  of the roughness. Every term is 0 at s = 0: at its own speed a vehicle has the C_r of the map, to the bit.
- a_w, the weighted vertical acceleration, from the geometric heave and roll over the geometric pitch.

Where a tile has no heightmap (it is rated from few points), the same quantities follow from its C_r alone.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, CostRule, Floats, UsageError
from bumpymap.rating.calibration import MAP_SPEED, Calibration, find_calibration, remembered, shipped_calibrations
from bumpymap.rating.ride.correction import Coefficients
from bumpymap.rating.ride.operator import Motions
from bumpymap.rating.vehicle_profile import Vehicle, less_floor, with_floor

QUANTITIES = ("c_r", "a_w")
"""Predicted at each speed: rad/m, m/s2."""
_LEAST = 1e-5
"""Geometric values below are rounding errors, rad/m and m/s2."""


@dataclass(frozen=True, slots=True)
class MotionFit(Coefficients):
    """How one quantity follows from the geometry, or from C_r alone."""

    model = "the record of speeds"

    terms: tuple[float, ...]
    """Coefficients of `motion_terms`."""
    plain: tuple[float, ...]
    """Coefficients of `plain_terms`."""
    log_sd: float
    """Standard deviation of the logarithm about ``terms``; of c_r, at twice or half the profile's speed."""
    plain_log_sd: float
    """The same about ``plain``."""


@dataclass(frozen=True, slots=True)
class MotionModel(Coefficients):
    """Model of the ride at several speeds, fitted to the drives of a calibration."""

    model = "the record of speeds"
    parts = dict.fromkeys(QUANTITIES, MotionFit.from_record)
    lengths = {"range": 2, "log_range": 2, "log_c_r_range": 2}  # noqa: RUF012 (a ClassVar of the base)
    lengths |= {"c_r.terms": 6, "a_w.terms": 10, "c_r.plain": 5, "a_w.plain": 6}

    range: tuple[float, float]
    """Lowest and highest speed that may be asked for, as shares of the profile's."""
    log_range: tuple[float, float]
    """Lowest and highest ln of the geometric C_r of the driven ground."""
    log_c_r_range: tuple[float, float]
    """The same of the C_r."""
    c_r: MotionFit
    a_w: MotionFit
    origin: dict[str, Any]
    """The data of the fit, and its errors."""

    def plain_log_factors(self, c_r: Floats, log_speed: Floats) -> Floats:
        """Return ln of each of ``QUANTITIES`` over the C_r at the profile's speed, rad/m, from it, (..., k, 2).

        ``log_speed`` (k,): ln of the speeds over the profile's.
        """
        terms = plain_terms(c_r, log_speed, self.log_c_r_range)
        return np.stack([terms[name] @ np.array(getattr(self, name).plain) for name in QUANTITIES], axis=-1)


def motion_terms(
    motions: Motions, pitch_change: Floats, log_speed: Floats, log_range: tuple[float, float]
) -> dict[str, Floats]:
    """Return the terms of each of ``QUANTITIES``, (n, k, terms), for n patches at k speeds.

    ``pitch_change`` (n,): geometric C_r at the profile's speed, rad/m; ``log_speed`` (k,): ln of the speeds over the
    profile's; ``log_range``: lowest and highest ln of the geometric C_r of the driven ground: the terms of the
    roughness stay beyond.
    """
    own = np.log(np.maximum(pitch_change, _LEAST))[:, None]
    changes = motions.pitch_change, motions.roll_change[:, None], motions.heave
    pitch, roll, heave = (np.log(np.maximum(change, _LEAST)) - own for change in changes)
    s, rough = log_speed, np.clip(own, *log_range)
    return {
        "c_r": _terms(pitch, s, s * rough, s * rough**2, s**2, s**2 * rough),
        "a_w": _terms(1.0, heave, rough, rough**2, s, s * rough, s**2, roll, heave * s, heave * rough),
    }


def plain_terms(c_r: Floats, log_speed: Floats, log_c_r_range: tuple[float, float]) -> dict[str, Floats]:
    """Return the terms of each of ``QUANTITIES`` from C_r [rad/m] alone, (..., k, terms)."""
    s, rough = log_speed, np.clip(np.log(np.maximum(c_r, _LEAST)), *log_c_r_range)[..., None]
    return {
        "c_r": _terms(s, s * rough, s * rough**2, s**2, s**2 * rough),
        "a_w": _terms(1.0, rough, rough**2, s, s * rough, s**2),
    }


def _terms(*values: Floats | float) -> Floats:
    return np.stack(np.broadcast_arrays(*values), axis=-1)


LEVEL = 5e-4
"""Geometric C_r of ground that is as good as level, rad/m."""


def at_speed(calibration: Calibration, speed: float | None) -> Calibration:
    """Return a calibration whose C_r is that at a speed [m/s]; itself at None and at the profile's own speed.

    Raises UsageError if the speed is out of the range that it holds for.
    """
    if speed is None:
        return calibration
    own, name = calibration.profile.speed_mps, calibration.profile.name
    low, high = (share * own for share in _model(calibration).range)
    if not low <= speed <= high:
        raise UsageError(
            f"`speed` is {speed:g} m/s; the calibration of {name} ({own:g} m/s) holds from {low:.3g} to {high:.3g} "
            "m/s. Give a speed in this range, or calibrate a profile with another speed_mps: bumpymap calibrate"
        )
    if speed == own:
        return calibration
    return replace(calibration, motion=calibration.motion | {MAP_SPEED: float(speed)})


def map_calibration(
    manifest: Mapping[str, Any], tile_size: float, file: Path | None = None, *, follow_paths: bool = False
) -> Calibration:
    """Find the calibration that a map was made with, at the speed of the map.

    ``manifest``: the content of its run.json; ``tile_size``: m; ``file``: the calibration, None: an included one with
    the preferences in run.json, or with ``follow_paths`` where run.json says that it was: a folder that somebody else
    made may name any path.

    Raises UsageError: it is not found; BadInputError: it is another one, or cannot be read.
    """
    about, wanted = manifest["vehicle"], manifest.get("calibration", {}).get("id", "")
    settings = manifest.get("settings", {}) if follow_paths else {}
    named, vehicle = file or settings.get("calibration"), str(settings.get("vehicle") or about["name"])
    speed = float(about["speed_mps"]) if "drives_mps" in about else None
    if not named:
        preferences = manifest.get("calibration", {}).get("preferences", {})
        for name in sorted(shipped_calibrations(), key=lambda name: name != about["name"]):
            own = Calibration.shipped(name, tile_size)
            with suppress(BadInputError, UsageError, TypeError):  # another vehicle, or preferences that make no sense
                profile = Vehicle.from_dict({**own.vehicle, **preferences}, name)
                included = at_speed(own.with_preferences(profile, name), speed)
                if included.id == wanted:
                    return included
    try:
        found = at_speed(find_calibration(vehicle, Path(named) if named else None, tile_size), speed)
    except (BadInputError, UsageError) as error:
        if file is not None:
            raise
        raise UsageError(
            f"the calibration {wanted} of the map is not found ({error}). Give its file with `calibration`"
        ) from error
    if found.id != wanted:
        raise BadInputError(
            f"the map was made with the calibration {wanted} of {about['name']}; {named or vehicle} holds {found.id}. "
            "Give the file of the map's own with `calibration`, or map the survey again"
        )
    return found


def plain_speed_factor(calibration: Calibration, log_c_r: Floats) -> Floats:
    """Return ln of C_r at the speed of the map over that at the profile's speed, from ln of the latter, any shape."""
    if calibration.map_speed == calibration.profile.speed_mps:
        return np.zeros_like(log_c_r)
    log_speed = _log_ratios(calibration, (calibration.map_speed,))
    return _model(calibration).plain_log_factors(np.exp(log_c_r), log_speed)[..., 0, 0]


def speed_log_sd(calibration: Calibration) -> float:
    """Return the standard deviation of ln C_r that the speed of the map adds."""
    if calibration.map_speed == calibration.profile.speed_mps:
        return 0.0
    (log_ratio,) = _log_ratios(calibration, (calibration.map_speed,))
    return float(_model(calibration).c_r.log_sd * min(abs(log_ratio) / np.log(2.0), 1.0))


def _log_ratios(calibration: Calibration, speeds: Sequence[float]) -> Floats:
    """Return ln of speeds [m/s] over the profile's."""
    return np.log(np.array(speeds) / calibration.profile.speed_mps)


def motion_factors(
    calibration: Calibration, speeds: Sequence[float], motions: Motions, pitch_change: Floats
) -> tuple[Floats, NDArray[np.float32]]:
    """Return ln of C_r at the map's speed over that at the profile's, (n,), and factors on the former, (n, 2 k).

    ``motions``: of `move_over` at k ``speeds`` [m/s], of which the map's is one; ``pitch_change`` (n,): geometric C_r
    at the profile's speed, rad/m. Factors for each speed: c_r over that of the map, and a_w [m/s2 per rad/m] over it.

    Both are NaN where the heightmap, without its noise, is as good as level: its form tells nothing then.
    """
    model = _model(calibration)
    terms = motion_terms(motions, pitch_change, _log_ratios(calibration, speeds), model.log_range)
    logs = np.stack([terms[name] @ np.array(getattr(model, name).terms) for name in QUANTITIES], axis=-1)
    logs[~(pitch_change > LEVEL)] = np.nan
    own = logs[:, speeds.index(calibration.map_speed), 0]
    return own, np.exp(logs - own[:, None, None]).reshape(len(logs), -1).astype(np.float32)


def motion_felt(
    calibration: Calibration, speeds: Sequence[float], factors: NDArray[np.float32], c_r: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return what is felt at k speeds [m/s], (..., 2 k): c_r [rad/m] and a_w [m/s2] each; NaN in unknown tiles.

    The factors are those of the driven C_r: the vehicle's floor is taken off before, and comes back to ``c_r`` alone.
    ``calibration``: at the speed of the map; ``factors`` (..., 2 k): of `motion_factors`, NaN where the
    heightmap does not tell; ``c_r`` (...): of the map, with the vehicle's floor, rad/m.
    """
    driven = less_floor(c_r, calibration.map_floor)
    known = np.isfinite(factors)
    if not known.all():
        factors = np.where(known, factors, plain_factors(calibration, speeds, driven))
    felt = factors * driven.astype(np.float32)[..., None]
    for number, speed in enumerate(speeds):
        own = number * len(QUANTITIES)
        felt[..., own] = with_floor(felt[..., own], calibration.floor_at(speed))
    return felt


def plain_factors(calibration: Calibration, speeds: Sequence[float], c_r: Floats) -> NDArray[np.float32]:
    """Return the factors of tiles without a heightmap, (..., 2 k), from the driven C_r [rad/m] at k speeds."""
    model, speed = _model(calibration), calibration.map_speed
    # The C_r at the profile's speed is not kept: what the map's speed made of it is taken off in one step.
    at_own = c_r * np.exp(-model.plain_log_factors(c_r, _log_ratios(calibration, (speed,)))[..., 0, 0])
    logs = model.plain_log_factors(at_own, _log_ratios(calibration, (*speeds, speed)))
    found = np.exp(logs[..., :-1, :] - logs[..., -1:, :1])
    return found.reshape(*c_r.shape, -1).astype(np.float32)


_STEPS, _SLOWEST = 17, 16.0
"""Speeds of `map_rule`, from the top speed down to this part of it, evenly spaced in logarithm."""
_DRIVEN = (1e-5, 10.0, 4001)
"""Lowest and highest driven C_r, rad/m, that they are found between, and how many."""


@remembered
def map_rule(calibration: Calibration) -> CostRule:
    """Return the rule of the cost, with the speed made good: the highest within ``[comfort]``, by C_r alone.

    At a speed, C_r and a_w follow from the C_r of the map as in tiles without a heightmap. A limit holds at every lower
    speed too. Below the calibrated speeds motion per metre stays that of the lowest, and a_w is in proportion to the
    speed, though it falls faster; above them nothing is known, so none is given.
    """
    limits, own = calibration.profile.comfort, calibration.profile.speed_mps
    low, high = (share * own for share in _model(calibration).range)
    top = min(limits.top_speed_mps or calibration.map_speed, high)
    speeds = np.geomspace(top, top / _SLOWEST, _STEPS)
    driven, known = np.geomspace(*_DRIVEN), np.clip(speeds, low, high)
    factors = plain_factors(calibration, known.tolist(), driven).astype(np.float64)
    felt = factors.reshape(len(driven), _STEPS, len(QUANTITIES))
    pitch_rate = with_floor(driven[:, None] * felt[..., 0] * speeds, calibration.floor * own)
    used = pitch_rate / limits.pitch_rate_radps
    if limits.a_w_mps2:
        used = np.maximum(used, driven[:, None] * felt[..., 1] * (speeds / known) / limits.a_w_mps2)
    used = np.maximum.accumulate(used, axis=0)  # rougher ground is not driven faster, nor ground fast and not slowly
    most = np.array([np.interp(1.0, column, driven) for column in used.T])
    c_r = with_floor(np.minimum.accumulate(most[::-1])[::-1], calibration.map_floor)
    first = np.flatnonzero(np.diff(c_r, prepend=-1.0) > 0.0)
    speeds_made = tuple((float(f"{c_r[at]:.6g}"), float(f"{speeds[at]:.6g}")) for at in first.tolist())
    return replace(calibration.cost_rule, speeds=speeds_made)


@remembered
def _model(calibration: Calibration) -> MotionModel:
    return MotionModel.from_record(calibration.motion)
