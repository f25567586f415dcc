"""Hold `bumpymap check` against drives whose truth is known.

python tests/benchmarks/drive_check.py --work FOLDER --layers LAYERS [--sets good cheap] [--only NAME]

LAYERS are those of godie_espacio.laz at default settings. The drives are made in DART once and kept in FOLDER: over
that map and over a site of the terrain library. Their sensors are simulated with the faults of `_sensor_sets.py`, and
what was measured is compared with what was put in: C_r of every stretch of 10 m, clock offset, mounting, floor. With
--stiffness and --damping the vehicle is another than its profile says; --sets without a name makes the drives alone.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from bumpymap.check import CheckConfig
from bumpymap.check.measure import DriveMeasure, WayStretch
from bumpymap.check.pipeline import _Done, _field, _measured, _stretches, agreement_of
from bumpymap.check.places import places_on_map
from bumpymap.core import BadInputError, MapAgreement
from bumpymap.layers import MapReader, open_map
from bumpymap.rating import Calibration, Vehicle

sys.path.append(str(Path(__file__).resolve().parents[1] / "worlds"))

from _library_site import EPSG, library_layers
from _sensor_sets import SETS
from _true_drives import KeptDrive, WayTask, heights_of, kept_ways, make_drives, stiff
from sensed_drives import SensedDrive, TrueDrive, sense_drive

Floats = NDArray[np.float64]
_IN_80 = 1.2816
GODIE_EPSG = 32614


@dataclass(frozen=True)
class Row:
    """One drive with one set of sensors."""

    sensed: SensedDrive
    done: _Done
    true: Floats
    """(n,) C_r of the stretches, rad/m."""

    @property
    def found(self) -> DriveMeasure:
        """What was found about the sensors."""
        return self.done.drive

    @property
    def cut(self) -> WayStretch:
        """The stretches."""
        return self.done.cut


def true_c_r(drive: TrueDrive, found: DriveMeasure, cut: WayStretch, start_s: float) -> Floats:
    """Return the true C_r of stretches: over the same samples, by pitch and way of the simulation."""
    time_s, way, pitched = drive.sampled
    inside = cut.label >= 0
    at, half = found.time[inside] - start_s, 0.5 / found.hertz
    sums = [
        np.bincount(
            cut.label[inside],
            np.interp(at + half, time_s, total) - np.interp(at - half, time_s, total),
            minlength=len(cut.start_s),
        )
        for total in (pitched, way)
    ]
    return sums[0] / sums[1]


def all_drives(work: Path, layers: Path, stiffness: float, damping: float) -> Iterator[KeptDrive]:
    """Make or read all drives; those of another suspension have another name."""
    profile, calibration = stiff(Vehicle.load("warthog"), stiffness, damping), Calibration.shipped("warthog")
    prefix = "" if stiffness == damping == 1 else f"stiff{stiffness:g}_damped{damping:g}_"
    site, site_layers = library_layers(work, calibration)
    for tag, folder, ground, count, weights in (
        ("godie_smooth", layers, heights_of(layers), 6, (5.0, 300.0)),
        ("godie_rough", layers, heights_of(layers), 8, (0.0, 20.0)),
        ("library", site_layers, site.along, 8, (0.0, 20.0)),
    ):
        ways = kept_ways(work / f"ways_{tag}.npz", folder, count, weights)
        tasks = [WayTask(f"{prefix}{tag}_{number:02}", way, profile) for number, way in enumerate(ways)]
        yield from make_drives(tasks, ground, folder, work)


@cache
def site_of(layers: Path) -> MapReader:
    """Open the map of a drive."""
    return open_map([layers])


def measured(kept: KeptDrive, set_name: str, seed: int) -> Row:
    """Simulate the sensors of a drive and measure it."""
    sensors = SETS[set_name](np.random.default_rng([seed, 1]))
    epsg = EPSG if "library" in kept.name else GODIE_EPSG
    motion = kept.motion
    sensed = sense_drive(motion, sensors, seed, f"{kept.name}_{set_name}", f"EPSG:{epsg}")
    site = site_of(kept.layers)
    places = places_on_map(sensed.log, site)
    done = _measured(sensed.log, places, CheckConfig((kept.name,)), site, _field(site, [places]))
    return Row(sensed, done, true_c_r(motion, done.drive, done.cut, sensed.start_s))


def say(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def report(name: str, rows: list[Row], refused: int, seconds: float) -> None:
    """Print what was found with one set of sensors."""
    true, read, sd = (np.concatenate([part(row) for row in rows]) for part in (_true, _read, _sd))
    inside = np.abs(read - true) <= _IN_80 * sd
    say(f"{name}: {len(rows)} drives ({refused} refused), {seconds / len(rows):.1f} s each")
    say(f"  measured against truth: {_compare(read, true)}, in the stated 80 %: {100 * inside.mean():.0f} %")
    said = np.concatenate([row.done.reading.c_r for row in rows if row.done.reading])
    say(f"  map against truth: {_compare(said, true)}")
    agreement = agreement_of(_stretches([row.done for row in rows], site_limits()))
    say(f"  map against measured: {_words(agreement)}")
    offset = 1000 * np.array([row.found.clock_offset_s - row.sensed.truth.clock_offset_s for row in rows])
    drift = np.array([row.found.clock_drift_ppm - row.sensed.truth.clock_drift_ppm for row in rows])
    mount = np.array([row.found.mount_deg for row in rows]) - np.array([row.sensed.truth.mount_deg for row in rows])
    floor = np.array([row.found.floor_radps for row in rows])
    true_floor = np.array([row.sensed.truth.floor_radps for row in rows])
    say(f"  clock offset {_spread(offset)} ms; drift {_spread(drift)} ppm")
    say(f"  roll {_spread(mount[:, 0])}, pitch {_spread(mount[:, 1])}, yaw {_spread(mount[:, 2])} degrees")
    if (true_floor > 0).all():
        say(f"  floor {np.median(true_floor):.4f} rad/s, found off by {_spread(100 * (floor / true_floor - 1))} %")


def _compare(values: Floats, true: Floats) -> str:
    """Describe how values agree with the truth."""
    known = np.isfinite(values)
    ratio = values[known] / true[known]
    error = 100 * np.abs(ratio - 1)
    return (
        f"{known.sum()} stretches, Spearman {spearmanr(values[known], true[known]).statistic:.3f}, median error "
        f"{np.median(error):.1f} %, 90 % within {np.quantile(error, 0.9):.0f} %, ratio {np.median(ratio):.3f}"
    )


def _words(agreement: MapAgreement) -> str:
    return (
        f"{agreement.stretches} stretches, Spearman {agreement.spearman:.3f}, median error "
        f"{100 * agreement.median_error:.1f} %, ratio {agreement.median_ratio:.3f}, in the interval "
        f"{100 * agreement.inside:.0f} %, same class {100 * agreement.same_class:.0f} %"
    )


def site_limits() -> tuple[float, ...]:
    """Return the class limits of the vehicle, rad/m."""
    return tuple(Calibration.shipped("warthog").class_limits)


def _true(row: Row) -> Floats:
    return row.true


def _read(row: Row) -> Floats:
    return row.cut.measured


def _sd(row: Row) -> Floats:
    return row.cut.measured_sd


def _spread(errors: Floats) -> str:
    """Describe errors: median of their size, largest, how many are not told."""
    told = np.abs(errors[np.isfinite(errors)])
    unknown = f", {len(errors) - len(told)} not told" if len(told) < len(errors) else ""
    if not len(told):
        return "not told"
    return f"{np.median(told):.3g} (largest {told.max():.3g}{unknown})"


def main() -> None:
    """Make the drives, measure them with each set of sensors, print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True, help="folder for the drives")
    parser.add_argument("--layers", type=Path, required=True, help="layers of godie_espacio.laz")
    parser.add_argument("--sets", nargs="*", default=["perfect", "good", "cheap"])
    parser.add_argument("--only", default="", help="drives whose name contains this")
    parser.add_argument("--stiffness", type=float, default=1.0, help="factor on the profile's suspension springs")
    parser.add_argument("--damping", type=float, default=1.0, help="factor on its dampers")
    parser.add_argument("--each", action="store_true", help="print every drive")
    given = parser.parse_args()
    drives = [
        kept for kept in all_drives(given.work, given.layers, given.stiffness, given.damping) if given.only in kept.name
    ]
    say(f"{len(drives)} drives, {sum(float(kept.facts['path_m']) for kept in drives):.0f} m")
    for name in given.sets:
        rows, refused, begin = [], 0, time.process_time()
        for number, kept in enumerate(drives):
            try:
                row = measured(kept, name, 1000 + number)
            except BadInputError as error:
                say(f"  {kept.name}: {error}")
                refused += 1
                continue
            rows.append(row)
            if given.each:
                ratio, told = np.round(row.cut.measured / row.true, 2), row.sensed.truth
                off = 1000 * (row.found.clock_offset_s - told.clock_offset_s)
                mount = np.subtract(row.found.mount_deg, told.mount_deg).round(2)
                say(f"  {kept.name}: clock {off:.0f} ms, mounting {mount} degrees, ratio {ratio}")
        report(name, rows, refused, time.process_time() - begin)


if __name__ == "__main__":
    main()
