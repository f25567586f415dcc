"""Move a calibration to simulated drives of a vehicle that is not what its profile says.

python tests/benchmarks/refit_drives.py --work FOLDER --layers LAYERS [--variant "rigid rockers"] [--sensors good]

LAYERS are those of godie_espacio.laz at default settings. A variant of the Warthog (see `unlike_vehicles.py`) is driven
over the ways of `drive_check.py`, kept in FOLDER, with the sensors of `_sensor_sets.py`, and checked by `bumpymap
check`. Drives of 100, 250 and 500 m in all, drawn several times, move the calibration. Printed is the median of the
map's C_r over the measured one on the drives that were not used, before and after, and whether it was refused.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np

from bumpymap.check import check_drives
from bumpymap.core import BadInputError, DrivenStretches
from bumpymap.rating import Calibration, DriveUpdate, Vehicle, update_from_drives
from bumpymap.rating.drive_posterior import respond

sys.path.append(str(Path(__file__).resolve().parents[1] / "worlds"))

from _sensor_sets import SETS
from _true_drives import KeptDrive, WayTask, heights_of, kept_ways, make_drives
from sensed_drives import sense_drive, write_drive_files
from unlike_vehicles import VARIANTS

GODIE_EPSG = 32614
LENGTHS_M = (100.0, 250.0, 500.0)
DRAWS = 8


def say(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def all_drives(work: Path, layers: Path, variant: str) -> Iterator[KeptDrive]:
    """Make or read the drives of a variant."""
    base = Vehicle.load("warthog")
    profile = VARIANTS[variant](base) if variant in VARIANTS else base
    prefix = "" if variant not in VARIANTS else variant.replace(" ", "_").replace(".", "p") + "_"
    for tag, count, weights in (("godie_smooth", 6, (5.0, 300.0)), ("godie_rough", 8, (0.0, 20.0))):
        ways = kept_ways(work / f"ways_{tag}.npz", layers, count, weights)
        tasks = [WayTask(f"{prefix}{tag}_{number:02}", way, profile) for number, way in enumerate(ways)]
        yield from make_drives(tasks, heights_of(layers), layers, work)


def checked(kept: KeptDrive, layers: Path, sensors: str, number: int) -> DrivenStretches:
    """Return what `bumpymap check` finds of a drive, read from its files."""
    drawn = SETS[sensors](np.random.default_rng([1000 + number, 1]))
    sensed = sense_drive(kept.motion, drawn, 1000 + number, kept.name, f"EPSG:{GODIE_EPSG}")
    with tempfile.TemporaryDirectory() as folder:
        place = ",".join(str(path) for path in write_drive_files(sensed.log, Path(folder)) if "wheels" not in path.name)
        return check_drives(layers, place).stretches


def joined(parts: list[DrivenStretches]) -> DrivenStretches:
    """Return the stretches of several drives, numbered in order."""
    columns = {each.name: np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(parts[0])}
    columns["drive"] = np.repeat(np.arange(len(parts)), [len(part.drive) for part in parts])
    return DrivenStretches(**columns)


def drawn(
    parts: list[DrivenStretches], length_m: float, rng: np.random.Generator
) -> tuple[DrivenStretches, DrivenStretches]:
    """Draw drives until they have a length, the last one cut short, and return them and the drives not drawn."""
    used, left = [], length_m
    order = rng.permutation(len(parts)).tolist()
    while left > 0 and order:
        part = parts[order.pop()]
        rows = np.cumsum(part.way_m) - part.way_m < left
        used.append(DrivenStretches(**{each.name: getattr(part, each.name)[rows] for each in fields(part)}))
        left -= float(used[-1].way_m.sum())
    return joined(used), joined([parts[number] for number in order])


def ratio_of(stretches: DrivenStretches, update: DriveUpdate | None = None) -> float:
    """Return the median of the map's C_r over the measured one, before or after an update."""
    known = np.isfinite(stretches.c_r) & (stretches.measured > 0)
    log_c_r = np.log(stretches.c_r[known])
    moved = log_c_r if update is None else respond(update.posterior.mean, log_c_r, update.prior)[0]
    return float(np.exp(np.median(moved - np.log(stretches.measured[known]))))


def try_length(parts: list[DrivenStretches], calibration: Calibration, length_m: float) -> None:
    """Move the calibration to drives of one length, several times, and print what the other drives say of it."""
    rng = np.random.default_rng(round(length_m))
    refused, before, after = [], [], []
    for _ in range(DRAWS):
        used, others = drawn(parts, length_m, rng)
        try:
            _, update = update_from_drives(calibration, used)
        except BadInputError as error:
            refused.append(str(error).split(":", 1)[0])
            continue
        before.append(ratio_of(others))
        after.append(ratio_of(others, update))
    reasons = ", ".join(f"{refused.count(reason)} x {reason}" for reason in sorted(set(refused)))
    found = f"other drives {_range(before)} -> {_range(after)}" if after else "never moved"
    say(f"  {length_m:4.0f} m: moved {len(after)} of {DRAWS}; {found}{'; refused: ' + reasons if reasons else ''}")


def _range(values: list[float]) -> str:
    return f"{np.median(values):.3f} ({min(values):.3f} to {max(values):.3f})"


def main() -> None:
    """Drive, check, move."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True, help="folder for the drives")
    parser.add_argument("--layers", type=Path, required=True, help="layers of godie_espacio.laz")
    parser.add_argument("--variant", default="rigid rockers", choices=["as it is", *VARIANTS])
    parser.add_argument("--sensors", default="good", choices=list(SETS))
    given = parser.parse_args()
    parts = []
    for number, kept in enumerate(all_drives(given.work, given.layers, given.variant)):
        try:
            parts.append(checked(kept, given.layers, given.sensors, number))
        except BadInputError as error:
            say(f"  {kept.name}: {error}")
    whole, calibration = joined(parts), Calibration.shipped("warthog")
    say(
        f"{given.variant}, sensors {given.sensors}: {len(parts)} drives, {whole.way_m.sum():.0f} m, "
        f"{len(whole.way_m)} stretches, map / measured {ratio_of(whole):.3f}"
    )
    for length_m in LENGTHS_M:
        try_length(parts, calibration, length_m)
    try:
        _, update = update_from_drives(calibration, whole)
    except BadInputError as error:
        say(f"  all: {error}")
        return
    mean, scale = update.posterior.mean.round(3).tolist(), update.posterior
    say(f"  all: {mean}, map's error {scale.map_scale:.2f}, lines {scale.line_sd:.2f}, ratio {update.ratio}")


if __name__ == "__main__":
    main()
