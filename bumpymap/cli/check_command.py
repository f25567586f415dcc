"""``bumpymap check``: a map against real drives over it."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._events import set_up_logging
from bumpymap.cli._options import given_options, output_options
from bumpymap.cli._progress import show_progress
from bumpymap.cli._terminal import FILE, PATH
from bumpymap.core import BumpymapError, UsageError

if TYPE_CHECKING:
    from bumpymap.cli._check_refit import Refit
    from bumpymap.core import CheckResult
    from bumpymap.rating import DriveUpdate

__all__ = ["command"]

_PARTLY_DONE = 4
_SETTINGS = {"band": "band_hz", "window": "window_m"}
"""Options that do not have the name of the setting."""


@click.command("check")
@click.argument("layers", type=PATH, metavar="[LAYERS]", required=False)
@click.option(
    "--drive",
    "drives",
    multiple=True,
    required=True,
    metavar="LOG",
    help="Log of a drive: CSV, a bag of ROS, ULog; files of one drive joined by commas. Can be repeated.",
)
@click.option(
    "--columns",
    metavar="LIST",
    help="Columns or topics of the log, such as rate_y=GyrY[deg/s],time=t [default: guessed and shown].",
)
@click.option("--out", type=PATH, metavar="DIR", help="Folder for the files: page, picture, tables, GIS layers.")
@click.option("--band", type=float, metavar="HZ", help="Rates are low-passed at this frequency [default: 10].")
@click.option("--window", type=float, metavar="M", help="Length of a stretch, at least 5 [default: 10].")
@click.option("--refit", type=FILE, metavar="FILE", help="Move the calibration of the map to the drives (JSON).")
@click.option(
    "--calibration", type=FILE, metavar="FILE", help="With --refit: calibration of the map [default: its own]."
)
@click.option("--overwrite", is_flag=True, help="Replace the files of an earlier check.")
@output_options()
@click.pass_context
def command(
    ctx: click.Context,
    /,
    layers: Path | None,
    drives: tuple[str, ...],
    *,
    quiet: bool,
    log_json: bool,
    columns: str | None,
    **given: Any,
) -> None:
    """Hold a map against real drives: LAYERS is a folder of `bumpymap map`; without it drives are measured alone.

    Drives that cannot be used are left out and named (exit code 4).

    \b
    bumpymap check site_layers --drive drive.mcap --out checked
    bumpymap check site_layers --drive imu.csv,gnss.csv --drive second.ulg
    bumpymap check --drive drive.csv
    bumpymap check site_layers --drive drive.mcap --refit my_robot.json
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    set_up_logging(as_json=log_json)
    from bumpymap.check import CheckConfig, run_check
    from bumpymap.readers import parse_columns

    refit = _refit(layers, given.pop("refit"), given.pop("calibration"), overwrite=given["overwrite"])
    settings = {_SETTINGS.get(name, name): value for name, value in given_options(given).items()}
    config = CheckConfig(drives, layers, columns=None if columns is None else parse_columns(columns), **settings)
    with show_progress(quiet=quiet, as_json=log_json) as progress:
        run = run_check(config, progress)
    update, refused = _moved(refit, run.result)
    if not quiet:
        from bumpymap.cli._check_summary import show

        show(run, config, None if refit is None or update is None else refit.record(update), as_json=log_json)
        if refit is not None and update is not None and not log_json:
            refit.show(update)
    if refused is not None:
        raise refused
    if run.result.skipped:
        ctx.exit(_PARTLY_DONE)


def _refit(layers: Path | None, out: Path | None, calibration: Path | None, *, overwrite: bool) -> "Refit | None":
    """Find the calibration to move, before drives are measured; None if none is to be moved."""
    if out is not None:
        from bumpymap.cli._check_refit import prepare_refit

        return prepare_refit(layers, calibration, out, overwrite=overwrite)
    if calibration is not None:
        raise UsageError("`calibration` is the one that `refit` moves: give `refit` too, or leave it out")
    return None


def _moved(refit: "Refit | None", result: "CheckResult") -> "tuple[DriveUpdate | None, BumpymapError | None]":
    """Move the calibration; what stands against that is told after the findings of the check."""
    if refit is None or result.ground is None:
        return None, None
    try:
        return refit.move(result.stretches, result.ground.speed_mps), None
    except BumpymapError as error:
        return None, error
