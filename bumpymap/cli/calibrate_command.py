"""``bumpymap calibrate``: drive a vehicle over simulated terrain and write what each kind of ground costs it."""

import os
import shlex
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bumpymap.atomic import atomic
from bumpymap.cli._terminal import DRIVES_KEPT, telling_how_to_go_on
from bumpymap.errors import OutputError, UsageError

if TYPE_CHECKING:
    from bumpymap.calibration import Calibration
    from bumpymap.vehicle.plan import CalibrationSettings
    from bumpymap.vehicle.pool import Progress
    from bumpymap.vehicle.profile import VehicleProfile


@click.command("calibrate")
@click.option(
    "--vehicle",
    default="warthog",
    metavar="NAME_OR_FILE",
    help="Vehicle that ships, or its TOML file [default: warthog].",
)
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Calibration file to write (JSON).")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Makes every random choice.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes; all processors by default.")
@click.option(
    "--patches", type=click.IntRange(min=2), default=8, show_default=True, help="Patches of each texture and z range."
)
@click.option("--starts", type=click.IntRange(min=1), default=3, show_default=True, help="Drives over each patch.")
@click.option(
    "--terrains",
    type=click.IntRange(min=1),
    default=24,
    show_default=True,
    help="Terrains of each kind of the library.",
)
@click.option(
    "--terrain-starts", type=click.IntRange(min=2), default=8, show_default=True, help="Drives over each terrain."
)
@click.option("--tile-size", type=float, default=3.0, show_default=True, help="Side of a patch, m.")
@click.option("--pixels", type=click.IntRange(min=4), default=15, show_default=True, help="Pixels along a side.")
@click.option("--quick", is_flag=True, help="A rough calibration in some minutes: a quarter of the drives.")
@click.option("--overwrite", is_flag=True, help="Replace OUT, and drop the progress of other settings.")
@click.option("--check", is_flag=True, help="Check the simulation against closed forms instead; writes nothing.")
def command(
    vehicle: str,
    out: Path | None,
    seed: int,
    workers: int | None,
    patches: int,
    starts: int,
    terrains: int,
    terrain_starts: int,
    tile_size: float,
    pixels: int,
    quick: bool,
    overwrite: bool,
    check: bool,
) -> None:
    """Drive a vehicle over simulated terrain: what each kind of ground costs it.

    An interrupted run goes on where it was when the same command is given again.
    """
    from bumpymap.vehicle.plan import CalibrationSettings
    from bumpymap.vehicle.profile import load_profile

    profile = load_profile(vehicle)
    if check:
        _check(profile, seed)
        return
    if out is None:
        raise UsageError("calibrate needs a file to write: --out FILE.json (or --check)")
    settings = CalibrationSettings(
        profile=profile,
        seed=seed,
        patches=patches,
        starts=starts,
        terrains=terrains,
        terrain_starts=terrain_starts,
        tile_size=tile_size,
        pixels=pixels,
    )
    if quick:
        settings = settings.quick()
    _calibrate(settings, out, workers or os.cpu_count() or 1, overwrite, _command_line(settings, vehicle, out, quick))


def _calibrate(settings: "CalibrationSettings", out: Path, workers: int, overwrite: bool, again: str) -> None:
    from bumpymap.vehicle.calibrate import calibrate
    from bumpymap.vehicle.journal import Journal
    from bumpymap.vehicle.model import require_dart
    from bumpymap.vehicle.ride_fit import fit_ride

    require_dart()
    _check_place(out, overwrite)
    journal = Journal(out.with_name(out.name + ".progress.jsonl"), settings.to_dict())
    with telling_how_to_go_on(DRIVES_KEPT), _progress(settings.total_drives) as report:
        calibration = calibrate(
            settings,
            report,
            workers=workers,
            journal=journal,
            discard_other=overwrite,
            command=again,
            fit=fit_ride,
        )
    with atomic(out) as beside:
        beside.write_text(calibration.to_json(), encoding="utf-8")
    journal.remove()
    _summary(calibration, out)


def _check_place(out: Path, overwrite: bool) -> None:
    """Refuse a place that cannot be written before the hours of work, not after."""
    if out.exists() and not overwrite:
        raise OutputError(f"{out} exists; give --overwrite to replace it, or another --out")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=out.parent, prefix=f".{out.name}."):
            pass
    except OSError as error:
        raise OutputError(f"cannot write {out}: {error}; choose an --out in a folder that you may write") from error


def _command_line(settings: "CalibrationSettings", vehicle: str, out: Path, quick: bool) -> str:
    """How to make the file again."""
    words = ["bumpymap", "calibrate", "--vehicle", vehicle, "--out", out.name, "--seed", str(settings.seed)]
    words += ["--patches", str(settings.patches), "--starts", str(settings.starts)]
    words += ["--terrains", str(settings.terrains), "--terrain-starts", str(settings.terrain_starts)]
    words += ["--tile-size", f"{settings.tile_size:g}", "--pixels", str(settings.pixels)]
    return shlex.join(words + (["--quick"] if quick else []))


@contextmanager
def _progress(total: int) -> Iterator["Progress | None"]:
    """Show a bar with the time to go, on a terminal only."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("driving"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("driving", total=total)

        def report(done: int, _total: int) -> None:
            bar.update(task, completed=done)

        yield report


def _summary(calibration: "Calibration", out: Path) -> None:
    from bumpymap.types import CLASS_NAMES
    from bumpymap.vehicle.library import library_terrains

    pairs = zip(sum(calibration.p_fail, ()), sum(calibration.drives, ()), strict=True)
    drives, failed = sum(map(sum, calibration.drives)), sum(share * count for share, count in pairs)
    click.echo(f"calibration {calibration.id} of {calibration.vehicle['name']}")
    click.echo(f"  {drives} drives over textures, {failed:.0f} failed")
    library = library_terrains(calibration)
    drives, failed = sum(t.drives for t in library), sum(t.failed for t in library)
    click.echo(f"  {drives} drives over {len(library)} terrains of the library, {failed} failed")
    limits = (0.0, *calibration.class_limits)
    for klass, (name, low, mean) in enumerate(zip(CLASS_NAMES, limits, calibration.class_c_r, strict=True)):
        click.echo(
            f"  class {klass} {name:10s} from {low:.3f} rad/m ({degrees(low):4.1f} deg/m), "
            f"mean {mean:.3f} rad/m ({degrees(mean):4.1f} deg/m)"
        )
    click.echo(f"wrote {out}")


def _check(profile: "VehicleProfile", seed: int) -> None:
    """Print a table of the checks; exit code 1 where one fails."""
    from bumpymap.vehicle.checks import all_checks

    failed = 0
    click.echo(f"{'check':52s} {'measured':>12s} {'allowed':>12s}")
    for result in all_checks(profile, seed):
        click.echo(
            f"{result.name:52s} {result.measured:12.3g} {result.allowed:>12s}  {'ok' if result.ok else 'FAILED'}"
        )
        failed += not result.ok
    if failed:
        click.echo(
            f"{failed} checks failed: do not trust its calibrations; look for a wrong number in the profile",
            err=True,
        )
        sys.exit(1)
