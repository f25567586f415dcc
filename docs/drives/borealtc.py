"""Print what a real Husky measured on five surfaces: python docs/drives/borealtc.py FOLDER.

FOLDER holds drives of the BorealTC data set (LaRocque et al. 2024, arXiv 2403.16877, CC0), a folder for each surface:
``imu_NN.csv`` (time [s], wx, wy, wz [rad/s], ax, ay, az [m/s2], 100 Hz) and ``pro_NN.csv`` (time, currents, velL, velR
[m/s], 6.5 Hz). Printed are C_r of each drive and surface (the table of docs/pages/ride-cost.md) with its spread
over windows of 5 m, and what the pitch rate on paved ground is made of.

Last comes what `bumpymap check --drive imu_NN.csv,pro_NN.csv` finds of the same drives, by its own rules.

A drive counts if it goes forward (mean wheel speed above 0.15 m/s) and nearly straight (the wheel speeds of the two
sides less than 0.3 m/s apart in the mean); of such a drive, the samples that do both count. Pitch rates are less their
median and low-passed at 10 Hz (Butterworth of order 4, run both ways).
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.signal import butter, find_peaks, sosfiltfilt, welch

from bumpymap.check import check_drives
from bumpymap.core import BadInputError

__all__ = ["FOLDERS", "WHOLE_SET", "BorealDrive", "lug_lines", "measure_surface", "read_boreal", "window_c_r"]

Floats = NDArray[np.float64]
FOLDERS = {"ice": "ICE", "asphalt": "ASPHALT", "indoor floor": "FLOORING", "snow": "SNOW", "silty loam": "SANDY_LOAM"}
WHOLE_SET = {"ice": 0.029, "asphalt": 0.038, "indoor floor": 0.060, "snow": 0.146, "silty loam": 0.282}
"""C_r measured on all drives of the set, of which a folder may hold a part, rad/m."""
RATE_HZ, BAND_HZ = 100.0, 10.0
FORWARD_MPS, APART_MPS = 0.15, 0.3
WHEEL_M = 2 * np.pi * 0.1651
"""Circumference of a wheel of the Husky A200."""
PAVED = ("ice", "asphalt", "indoor floor")
_WINDOW_M = 5.0
_PER_METRE = 200
"""Samples in a metre of way, for spectra over the way."""
_LINE = 1.5
"""Half the width of a line, periods per metre."""


@dataclass(frozen=True)
class BorealDrive:
    """One drive; arrays (n,) at 100 Hz."""

    name: str
    pitch_rate: Floats
    """Less its median, all frequencies, rad/s."""
    felt: Floats
    """Low-passed, rad/s."""
    speed: Floats
    """Mean of both sides, m/s."""
    apart: Floats
    """Speed of the right side less that of the left, m/s."""

    @property
    def is_driven(self) -> bool:
        """True if it goes forward and nearly straight in the mean."""
        return bool(self.speed.mean() > FORWARD_MPS and np.abs(self.apart).mean() < APART_MPS)

    @property
    def counts(self) -> NDArray[np.bool_]:
        """(n,) samples that go forward and nearly straight; none if the whole drive does not."""
        return (self.speed > FORWARD_MPS) & (np.abs(self.apart) < APART_MPS) & self.is_driven

    @property
    def way_m(self) -> float:
        """Way of the samples that count."""
        return float(self.speed[self.counts].sum() / RATE_HZ)

    @property
    def c_r(self) -> float:
        """Integral of the absolute pitch rate over the way, rad/m."""
        return float(np.abs(self.felt[self.counts]).sum() / RATE_HZ / self.way_m)

    @property
    def turning(self) -> float:
        """Mean absolute pitch rate while it turns on the spot, rad/s; NaN without 5 s of it."""
        turns = (np.abs(self.speed) < 0.05) & (np.abs(self.apart) > 0.1)
        return float(np.abs(self.felt[turns]).mean()) if turns.sum() >= 5 * RATE_HZ else float("nan")

    @property
    def standing(self) -> float:
        """Mean absolute pitch rate while no wheel has turned for half a second, rad/s; NaN without 2 s of it."""
        still = (np.abs(self.speed) + np.abs(self.apart) / 2) < 0.01
        still = binary_erosion(still, iterations=round(RATE_HZ / 2))
        return float(np.abs(self.felt[still]).mean()) if still.sum() >= 2 * RATE_HZ else float("nan")


def read_boreal(folder: Path) -> list[BorealDrive]:
    """Read all drives of a folder, in the order of their numbers."""
    drives = []
    for path in sorted(folder.glob("imu_*.csv")):
        imu = np.genfromtxt(path, delimiter=",", names=True)
        wheels = np.genfromtxt(path.with_name(path.name.replace("imu", "pro")), delimiter=",", names=True)
        left, right = (np.interp(imu["time"], wheels["time"], wheels[side]) for side in ("velL", "velR"))
        rate = imu["wy"] - np.median(imu["wy"])
        felt = sosfiltfilt(butter(4, BAND_HZ, fs=RATE_HZ, output="sos"), rate)
        drives.append(BorealDrive(path.stem.removeprefix("imu_"), rate, felt, (left + right) / 2, right - left))
    return drives


def window_c_r(drive: BorealDrive, length_m: float = _WINDOW_M) -> Floats:
    """Return C_r of the windows of a drive, rad/m, without the last that is not full."""
    speed, felt = drive.speed[drive.counts], np.abs(drive.felt[drive.counts])
    way = np.cumsum(speed) / RATE_HZ
    window = np.floor(way / length_m).astype(np.int64)
    turned, length = np.bincount(window, felt), np.bincount(window, speed)
    return (turned / np.maximum(length, 1e-9))[:-1]


def measure_surface(drives: list[BorealDrive]) -> tuple[float, float, float]:
    """Return C_r of all drives that count, and the 2.5 % and 97.5 % quantiles of bootstrapped windows, rad/m."""
    driven = [drive for drive in drives if drive.is_driven]
    way = np.array([drive.way_m for drive in driven])
    c_r = float(np.array([drive.c_r for drive in driven]) @ way / way.sum())
    windows = np.concatenate([window_c_r(drive) for drive in driven])
    drawn = np.random.default_rng(1).choice(windows, (10_000, len(windows))).mean(axis=1)
    low, high = np.quantile(drawn, (0.025, 0.975))
    return c_r, float(low), float(high)


def way_spectrum(drive: BorealDrive) -> tuple[Floats, Floats]:
    """Return periods per metre and the power of the pitch rate, (rad/s)^2 each, of the samples that count.

    Sampled evenly along the way, so that what turns with the wheels is a line at any speed.
    """
    way = np.cumsum(drive.speed[drive.counts]) / RATE_HZ
    places = np.arange(way[0], way[-1], 1 / _PER_METRE)
    rate = np.interp(places, way, drive.felt[drive.counts])
    period, density = welch(rate, _PER_METRE, nperseg=min(2 * _PER_METRE, len(rate)))
    return period, density * (period[1] - period[0])


def lug_lines(drive: BorealDrive, lugs_per_m: float) -> float:
    """Return the root mean square of the pitch rate in the lines at multiples of a number of periods per metre, rad/s.

    What lies as high beside the lines as under them is taken off.
    """
    period, power = way_spectrum(drive)
    total = 0.0
    for line in np.arange(lugs_per_m, period[-1] - lugs_per_m, lugs_per_m):
        off = np.abs(period - line)
        near, beside = off <= _LINE, (off > _LINE) & (off <= lugs_per_m / 2)
        total += max(power[near].sum() - near.sum() * np.median(power[beside]), 0.0)
    return float(np.sqrt(total))


def lugs_of(drives: list[BorealDrive]) -> float:
    """Return the periods per metre of the lowest line that all drives over paved ground have, from 10 to 30."""
    spectra = [way_spectrum(drive) for drive in drives]
    grid = np.arange(10, 30, 0.1)
    total = np.mean([np.log(np.interp(grid, period, power)) for period, power in spectra], axis=0)
    peaks, _ = find_peaks(total)
    return float(grid[peaks[np.argmax(total[peaks])]])


def main(folder: Path) -> None:
    """Print the tables."""
    surfaces = {name: read_boreal(folder / sub) for name, sub in FOLDERS.items()}
    print("| surface | drive | way, m | speed, m/s | C_r, rad/m | standing, rad/s | turning on the spot, rad/s |")
    print("|---|---|---|---|---|---|---|")
    for name, drives in surfaces.items():
        for drive in drives:
            own = ["", "", ""]
            if drive.is_driven:
                own = [f"{drive.way_m:.1f}", f"{np.median(drive.speed[drive.counts]):.2f}", f"{drive.c_r:.4f}"]
            own += [f"{rate:.4f}" if np.isfinite(rate) else "" for rate in (drive.standing, drive.turning)]
            print(f"| {name} | {drive.name} | {' | '.join(own)} |")
    print("\n| surface | way, m | C_r, rad/m | 95 % of windows | whole set | ratio |\n|---|---|---|---|---|---|")
    for name, drives in surfaces.items():
        c_r, low, high = measure_surface(drives)
        way = sum(drive.way_m for drive in drives if drive.is_driven)
        print(
            f"| {name} | {way:.0f} | {c_r:.4f} | {low:.3f} to {high:.3f} | {WHOLE_SET[name]:.3f} "
            f"| {c_r / WHOLE_SET[name]:.2f} |"
        )
    paved = [(name, drive) for name in PAVED for drive in surfaces[name] if drive.is_driven]
    lugs = lugs_of([drive for _, drive in paved])
    print(f"\nlines at multiples of {lugs:.1f} periods per metre: {lugs * WHEEL_M:.1f} in a turn of the wheel")
    print("| surface | drive | speed, m/s | mean abs pitch rate, rad/s | rms | lines | below 2 Hz | rest |")
    print("|---|---|---|---|---|---|---|---|")
    for name, drives in surfaces.items():
        print("\n".join(_parts(name, drive, lugs) for drive in drives if drive.is_driven))
    rates = np.array([np.abs(drive.felt[drive.counts]).mean() for _, drive in paved])
    print(f"\nmean absolute pitch rate on paved ground: median {np.median(rates):.4f} rad/s of {len(rates)} drives")
    print("\n| surface | drive | counts, m | C_r, rad/m | left out |\n|---|---|---|---|---|")
    for name, sub in FOLDERS.items():
        print("\n".join(checked_row(name, folder / sub, drive) for drive in surfaces[name] if drive.is_driven))


def checked_row(name: str, folder: Path, drive: BorealDrive) -> str:
    """Return a line of what `bumpymap check` finds of a drive, its sensor's floor taken off where it stands."""
    place = ",".join(str(folder / f"{kind}_{drive.name}.csv") for kind in ("imu", "pro"))
    try:
        found = check_drives(None, place)
    except BadInputError:
        return f"| {name} | {drive.name} | 0 | | no stretch of 5 m |"
    one, stretches = found.drives[0], found.stretches
    c_r = np.average(stretches.measured, weights=stretches.way_m)
    lost = ", ".join(f"{reason} {metres:.1f} m" for reason, metres in one.left_out_m.items() if metres >= 0.5)
    return f"| {name} | {drive.name} | {one.used_m:.1f} | {c_r:.4f} | {lost} |"


def _parts(name: str, drive: BorealDrive, lugs: float) -> str:
    """Return a line of the table of parts, rms in rad/s."""
    felt, speed = drive.felt[drive.counts], float(np.median(drive.speed[drive.counts]))
    total, lines = float(np.sqrt(np.mean(felt**2))), lug_lines(drive, lugs)
    period, power = way_spectrum(drive)
    slow = float(np.sqrt(power[period * speed < 2.0].sum()))
    rest = float(np.sqrt(max(total**2 - lines**2 - slow**2, 0.0)))
    return (
        f"| {name} | {drive.name} | {speed:.2f} | {np.abs(felt).mean():.4f} | {total:.4f} | {lines:.4f} | {slow:.4f} "
        f"| {rest:.4f} |"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
