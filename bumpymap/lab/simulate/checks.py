"""Validate the simulation with drives of known result: planes, sine waves, half the time step, repeated runs."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bumpymap.lab.simulate.drive import Drive, DriveSettings, Start, drive, drive_from
from bumpymap.lab.simulate.jobs import run_in_processes
from bumpymap.lab.simulate.terrain import PatchGround, PlaneGround, SineGround
from bumpymap.rating import Vehicle, make_textures

__all__ = ["all_checks"]

_SINE_AMPLITUDE_M = 0.02
_SINE_SPEED_MPS = 1.0
_ROUGH_Z_RANGE_M = 0.3


@dataclass(frozen=True, slots=True)
class SimulatorCheck:
    """A measured number and the range that it must lie in."""

    name: str
    measured: float
    allowed: str
    ok: bool


def all_checks(profile: Vehicle, seed: int = 1) -> Iterator[SimulatorCheck]:
    """Run all checks and yield each result; planes go up to 30 degrees or the vehicle's slope limit."""
    yield check_plane(profile, 0.0)
    for degrees in (10.0, 20.0, 30.0):
        if degrees <= profile.slope_limit_deg:
            yield from (check_plane(profile, degrees, heading) for heading in (0.0, 45.0, 90.0))
    distance = _sine_speed(profile) * DriveSettings().measure_s
    # Whole and half numbers of waves: the mean over another part of a wave differs from that of the whole wave.
    for wavelength in (distance / waves for waves in (5, 4, 3, 2, 1.5, 1)):
        if wavelength > 2 * profile.wheelbase_m:
            yield check_sine(profile, wavelength)
    yield check_step(profile, patches=24, seed=seed)
    yield check_repeat(profile, seed)


def check_plane(
    profile: Vehicle, degrees: float, heading_deg: float = 0.0, settings: DriveSettings | None = None
) -> SimulatorCheck:
    """Check that C_r on a plane is below 0.001 rad/m. Heading 0 goes straight up the slope, 90 along it."""
    ground = PlaneGround((math.tan(math.radians(degrees)), 0.0))
    result = drive_from(profile, ground, Start(0.0, 0.0, math.radians(heading_deg)), 0, settings)
    name = f"plane of {degrees:g} deg, heading {heading_deg:g} deg: C_r [rad/m]"
    return SimulatorCheck(name, result.c_r, "< 0.001", result.c_r < 0.001)


def sine_c_r(profile: Vehicle, amplitude: float, wavelength: float) -> float:
    """Return C_r of a vehicle whose axles follow a sine, rad/m.

    The axles are W apart, so the pitch is a sine of amplitude ``2 A sin(pi W / L) / W`` (small angles). In every wave
    the absolute pitch changes add up to four times that: ``C_r = 8 A sin(pi W / L) / (W L)``.
    """
    base = profile.wheelbase_m
    return 8 * amplitude * math.sin(math.pi * base / wavelength) / (base * wavelength)


def check_sine(profile: Vehicle, wavelength: float, settings: DriveSettings | None = None) -> SimulatorCheck:
    """Check that C_r on waves longer than twice the wheelbase is within 5 % of the closed form.

    The speed is at most 1 m/s: the closed form ignores the suspension, and a fast vehicle on soft springs does pitch
    further.
    """
    slow = replace(profile, speed_mps=_sine_speed(profile))
    result = drive_from(slow, SineGround(_SINE_AMPLITUDE_M, wavelength), Start(0.0, 0.0, 0.0), 0, settings)
    error = 100 * (result.c_r / sine_c_r(profile, _SINE_AMPLITUDE_M, wavelength) - 1)
    return SimulatorCheck(f"sine of 2 cm, L = {wavelength:.3g} m: error [%]", error, "+-5", abs(error) <= 5)


def _sine_speed(profile: Vehicle) -> float:
    return min(profile.speed_mps, _SINE_SPEED_MPS)


def check_step(profile: Vehicle, patches: int, seed: int = 1, settings: DriveSettings | None = None) -> SimulatorCheck:
    """Check that halving the time step changes the mean C_r over rough patches by less than 3 %."""
    settings = settings or DriveSettings()
    finer = replace(settings, physics=replace(settings.physics, time_step=settings.physics.time_step / 2))
    textures = make_textures("high_noise", patches, np.random.default_rng(seed)).astype(np.float64)
    grounds = [PatchGround.from_heights(patch * _ROUGH_Z_RANGE_M, 3.0) for patch in textures]
    c_r = np.array(
        [
            [drive(profile, ground, seed + i, chosen).c_r for chosen in (settings, finer)]
            for i, ground in enumerate(grounds)
        ]
    )
    coarse, fine = c_r[np.isfinite(c_r).all(axis=1)].sum(axis=0)  # patches that both steps crossed
    change = 100 * (fine / coarse - 1) if coarse > 0 else math.nan
    return SimulatorCheck(f"half the time step, {patches} rough patches: change [%]", change, "+-3", abs(change) < 3)


def check_repeat(profile: Vehicle, seed: int = 1, settings: DriveSettings | None = None) -> SimulatorCheck:
    """Check that a seed gives the same bits twice in this process and once in another process."""
    settings = settings or DriveSettings()
    run = partial(_rough_drive, profile, settings=settings)
    results = [run(seed), run(seed), *run_in_processes(run, [seed], 1)]
    spread = max(d.c_r for d in results) - min(d.c_r for d in results)
    same = results[0] == results[1] == results[2]
    return SimulatorCheck("same seed, again and in another process: change", spread, "0", same)


def _rough_drive(profile: Vehicle, seed: int, *, settings: DriveSettings) -> Drive:
    patch = make_textures("high_noise", 1, np.random.default_rng(seed))[0].astype(np.float64)
    return drive(profile, PatchGround.from_heights(patch * _ROUGH_Z_RANGE_M, 3.0), seed, settings)
