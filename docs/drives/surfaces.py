"""Drive the Husky over made-up surfaces in simulation, beside what a real one measured: python docs/drives/surfaces.py.

Heights are random fields on a grid of 2 cm that goes on forever, by statistics of roughness from the literature where
there are some:

- paved and gravel roads: ISO 8608, the power of profiles falls with the square of the wave number; at 0.1 periods per
  metre it is 16 (class A, asphalt), 256 (class C) to 1,024 (class D, gravel) times 1e-6 m3. Ice: the smooth end of
  class A, 8e-6 m3.
- indoor floor: tiles of 0.3 m whose edges are up to 0.8 mm apart, an assumption.
- soil: random roughness by tool as commonly cited after Zobeck and Onstad (1987), whose paper we have not read (15 mm
  after a field cultivator, 18 mm after a disk, 32 mm after a mouldboard plough); that it is correlated over 0.1 m is
  an assumption, and so are furrows, ridges of 5 cm every 0.75 m besides.
- snow with footprints: 12 mm, correlated over 0.15 m. An assumption: snow yields under the wheels.

A drive is simulated on means over pixels of 0.2 m, which is what a map sees; on the grid of 2 cm, where a rigid wheel
feels every grain; and on that grid averaged over the patch that a tyre bears on. C_r is that of the pitch rate
low-passed at 10 Hz, like the measured one. The ride model rates the pixels of 0.2 m. Takes some minutes and DART;
options: ``--drives N`` of each (8), ``--calibration FILE`` in the place of the included one.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import cos, hypot, pi, remainder, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.signal import butter, sosfiltfilt

from bumpymap.lab.settings import Physics
from bumpymap.lab.simulate.model import DartVehicle, Strip, fit_plane
from bumpymap.rating import Calibration, RideModel, Vehicle, roll_over

Floats = NDArray[np.float64]
STEP_M, SIZE = 0.02, 1024
"""Grid of the surfaces, 20.48 m square."""
PIXEL = 10
"""Nodes of that grid along a pixel of a map."""
SAMPLE_S, STEPS = 0.01, 5
SETTLE_S, RAMP_S, MEASURE_S = 1.0, 2.0, 12.0
HALF_WIDTH_M = 1.1
TYRE = 4
"""Nodes along the patch that a tyre bears on, 8 cm: a Husky's is 11 cm wide and, 3 mm pressed in, 6.5 cm long."""
SLOW_HZ = 2.0
"""At 0.4 m/s waves of 0.2 m, the pixel of a map, have this frequency."""


@dataclass(frozen=True)
class Surface:
    """A made-up surface and what a real Husky measured on its like."""

    name: str
    heights: Floats
    """(n, n) m, periodic."""
    drives: tuple[tuple[float, float | None], ...]
    """Speed [m/s] and measured C_r [rad/m] of real drives."""


@dataclass(frozen=True)
class GridGround:
    """Periodic heights, bilinear between nodes."""

    heights: Floats
    step: float
    spacing: float = STEP_M
    gradient: tuple[float, float] = (0.0, 0.0)

    @property
    def extent(self) -> float:
        """Side of the grid, m."""
        return len(self.heights) * self.step

    def height(self, easting: Floats, northing: Floats) -> Floats:
        """Heights of points, m."""
        x, y = easting / self.step, northing / self.step
        col, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        right, up, n = x - col, y - row, len(self.heights)
        z = self.heights
        below = z[row % n, col % n] * (1 - right) + z[row % n, (col + 1) % n] * right
        above = z[(row + 1) % n, col % n] * (1 - right) + z[(row + 1) % n, (col + 1) % n] * right
        return np.asarray(below * (1 - up) + above * up)


def random_field(power: Floats, seed: int) -> Floats:
    """Return a periodic random field with a two-dimensional spectrum, (n, n) m^4 on the wave numbers of the grid."""
    white = np.fft.fft2(np.random.default_rng(seed).standard_normal((SIZE, SIZE)))
    amplitude = np.sqrt(power) / STEP_M
    amplitude[0, 0] = 0.0
    return np.real(np.fft.ifft2(white * amplitude))


def wave_numbers() -> Floats:
    """Return the wave numbers of the grid, (n, n) periods per metre."""
    axis = np.fft.fftfreq(SIZE, STEP_M)
    return np.hypot(axis[:, None], axis[None, :])


def road(unevenness: float, seed: int) -> Floats:
    """Return a road whose profiles have the one-sided power ``unevenness`` (0.1 / n)^2 m3 at n periods per metre."""
    # The one-sided power of a profile is 4 C / n^2 where the surface has C / k^3.
    wave = np.maximum(wave_numbers(), 1 / (SIZE * STEP_M))
    return random_field(unevenness * 0.1**2 / 4 / wave**3, seed)


def soil(deviation_m: float, length_m: float, seed: int) -> Floats:
    """Return a field of a standard deviation whose correlation falls exponentially over a length."""
    power = 2 * pi * length_m**2 / (1 + (2 * pi * wave_numbers() * length_m) ** 2) ** 1.5
    field = random_field(power, seed)
    return np.asarray(field * (deviation_m / field.std()))


def tiled_floor(seed: int) -> Floats:
    """Return tiles of 0.32 m whose heights differ by up to 0.8 mm."""
    tile = 16
    lift = np.random.default_rng(seed).uniform(-0.0004, 0.0004, (SIZE // tile, SIZE // tile))
    return np.repeat(np.repeat(lift, tile, axis=0), tile, axis=1)


def surfaces() -> list[Surface]:
    """Return all surfaces, with the drives that they are held against."""
    ridges = 0.025 * np.sin(2 * pi * np.arange(SIZE) * round(SIZE * STEP_M / 0.75) / SIZE)
    return [
        Surface("level plane", np.zeros((SIZE, SIZE)), ((0.23, None),)),
        Surface("ice: smooth end of ISO class A", road(8e-6, 1), ((0.23, 0.0406),)),
        Surface("indoor floor: tiles, 0.8 mm", tiled_floor(2), ((0.23, 0.0574),)),
        Surface("asphalt: ISO class A", road(16e-6, 3), ((0.23, 0.1619), (0.46, 0.0379), (0.79, 0.0165))),
        Surface("gravel: ISO class C", road(256e-6, 4), ((0.4, None),)),
        Surface("gravel: ISO class D", road(1024e-6, 4), ((0.4, None),)),
        Surface("snow: 12 mm over 0.15 m", soil(0.012, 0.15, 5), ((0.39, 0.1635),)),
        Surface("loam, cultivated: 15 mm over 0.1 m", soil(0.015, 0.1, 6), ((0.39, 0.2850),)),
        Surface("loam, disked: 18 mm over 0.1 m", soil(0.018, 0.1, 6), ((0.39, 0.2850),)),
        Surface("loam, ploughed: 32 mm over 0.1 m", soil(0.032, 0.1, 6), ((0.39, 0.2850),)),
        Surface("furrows: 5 cm every 0.75 m, 15 mm", soil(0.015, 0.1, 7) + ridges, ((0.4, None),)),
    ]


def pixel_means(heights: Floats, nodes: int = PIXEL) -> Floats:
    """Return the means over pixels of some nodes, 0.2 m by default, as many as fit."""
    n = SIZE // nodes
    return np.asarray(heights[: n * nodes, : n * nodes].reshape(n, nodes, n, nodes).mean(axis=(1, 3)))


class Felt(NamedTuple):
    """Ride of one simulated drive."""

    c_r: float
    """Of the pitch rate low-passed at 10 Hz, rad/m; NaN if it does not get on."""
    slow: float
    """Root mean square of the pitch rate below 2 Hz, rad/s."""
    fast: float
    """The same from 2 to 10 Hz."""


def simulate(profile: Vehicle, ground: GridGround, seed: int) -> Felt:
    """Drive once over a surface."""
    easting, northing, turn = np.random.default_rng(seed).random(3).tolist()
    length = profile.speed_mps * (RAMP_S + MEASURE_S)
    strip = Strip(easting * ground.extent, northing * ground.extent, 2 * pi * turn, length, HALF_WIDTH_M)
    vehicle = DartVehicle(profile, ground, strip, Physics())
    rates, way, before = [], 0.0, vehicle.pose()
    for sample in range(round((SETTLE_S + RAMP_S + MEASURE_S) / SAMPLE_S)):
        seconds = sample * SAMPLE_S - SETTLE_S
        speed = profile.speed_mps * min(max(seconds / RAMP_S, 0.0), 1.0)
        aside = (before.northing - strip.northing) * cos(strip.heading)
        aside -= (before.easting - strip.easting) * sin(strip.heading)
        wanted = (
            min(max(profile.track_m * remainder(strip.heading - before.heading - aside, 2 * pi), -0.3), 0.3) * speed
        )
        vehicle.command(speed - wanted, speed + wanted)
        vehicle.advance(STEPS)
        pose = vehicle.pose()
        rates.append(pose.pitch_rate)
        if seconds >= RAMP_S:
            way += hypot(pose.easting - before.easting, pose.northing - before.northing)
        before = pose
    felt = sosfiltfilt(butter(4, 10.0, fs=1 / SAMPLE_S, output="sos"), rates)[-round(MEASURE_S / SAMPLE_S) :]
    c_r = float(np.abs(felt).sum() * SAMPLE_S / way) if way > 0.8 * profile.speed_mps * MEASURE_S else float("nan")
    slow = sosfiltfilt(butter(4, SLOW_HZ, fs=1 / SAMPLE_S, output="sos"), felt)
    return Felt(c_r, float(slow.std()), float((felt - slow).std()))


def model_c_r(model: RideModel, heights: Floats) -> float:
    """Return the mean C_r of the ride model over the tiles of a surface, without floor, rad/m."""
    pixels = model.calibration.pixels
    n = len(heights) // pixels
    tiles = heights[: n * pixels, : n * pixels].reshape(n, pixels, n, pixels).swapaxes(1, 2).reshape(-1, pixels, pixels)
    relief = np.stack([tile - fit_plane(tile)[0] for tile in tiles]).astype(np.float32)
    rides = roll_over(relief, model.operator)
    found = model.correction.predict(rides, np.zeros(len(tiles)), np.zeros(len(tiles)), np.full(len(tiles), 10.0))
    return float(np.exp(found.log_c_r).mean())


def rows(calibration: Calibration, drives: int) -> Iterator[str]:
    """Make the lines of the table."""
    profile = Vehicle.from_dict(calibration.vehicle, "calibration")
    model, floor_radps = RideModel(calibration), calibration.floor * profile.speed_mps
    for surface in surfaces():
        coarse = pixel_means(surface.heights)
        rated = model_c_r(model, coarse)
        for speed, measured in surface.drives:
            at_speed = replace(profile, speed_mps=speed)
            found = [
                np.nanmean([simulate(at_speed, ground, seed) for seed in range(drives)], axis=0)
                for ground in (
                    GridGround(coarse, PIXEL * STEP_M, spacing=0.1),
                    GridGround(surface.heights, STEP_M),
                    GridGround(uniform_filter(surface.heights, TYRE, mode="wrap"), STEP_M),
                )
            ]
            (pixels, rigid), tyre, floor = (one[0] for one in found[:2]), Felt(*found[2]), floor_radps / speed
            with_floor = hypot(tyre.c_r, floor)
            beside = " | " if measured is None else f"{measured:.3f} | {with_floor / measured:.2f}"
            yield (
                f"| {surface.name} | {speed:.2f} | {rated:.3f} | {pixels:.3f} | {rigid:.3f} | {tyre.c_r:.3f} "
                f"| {tyre.slow:.3f} | {tyre.fast:.3f} | {floor:.3f} | {with_floor:.3f} | {beside} |"
            )


def finer_pixels(profile: Vehicle, drives: int) -> Iterator[str]:
    """Make the lines of the table of C_r by the size of pixels."""
    for surface in surfaces():
        if not surface.name.startswith(("snow", "loam, cultivated")):
            continue
        found = []
        for nodes in (10, 5, 4, 2):
            ground = GridGround(pixel_means(surface.heights, nodes), nodes * STEP_M, max(STEP_M, nodes * STEP_M / 2))
            at_speed = replace(profile, speed_mps=surface.drives[0][0])
            found.append(np.nanmean([simulate(at_speed, ground, seed).c_r for seed in range(drives)]))
        yield f"| {surface.name} | {' | '.join(f'{c_r:.3f}' for c_r in found)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--drives", type=int, default=8)
    parser.add_argument("--calibration")
    options = parser.parse_args()
    if options.calibration:
        calibration = Calibration.load(options.calibration)
        calibration = calibration.with_preferences(Vehicle.load("husky").to_dict(), options.calibration)
    else:
        calibration = Calibration.shipped("husky")
    print(
        "| surface | speed, m/s | ride model | pixels of 0.2 m | 2 cm, rigid wheel | 2 cm, tyre | its rms below 2 Hz, "
        "rad/s | 2 to 10 Hz | floor | with floor | measured | ratio |"
    )
    print(f"{'|---' * 12}|")
    for row in rows(calibration, options.drives):
        print(row, flush=True)
    print("\n| surface | pixels of 0.2 m | 0.1 m | 0.08 m | 0.04 m |\n|---|---|---|---|---|")
    for row in finer_pixels(Vehicle.from_dict(calibration.vehicle, "calibration"), options.drives):
        print(row, flush=True)


if __name__ == "__main__":
    main()
