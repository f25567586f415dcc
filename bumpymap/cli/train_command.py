"""``bumpymap train``: train the texture network, or the network for the sectors of scans."""

from collections.abc import Callable
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import FILE, PATH, CommandGroup, GroupedOption, Run, job, settings_options
from bumpymap.cli._progress import CommandProgress
from bumpymap.cli._text import interrupt_note
from bumpymap.core import OutputError, Progress, UsageError, install_command
from bumpymap.lab import NetworkSettings, ScanTrainSettings, TrainSettings

if TYPE_CHECKING:
    from bumpymap.lab import EpochReport, Evaluation, ScanEvaluation


@click.group("train", cls=CommandGroup)
def command() -> None:
    """Train the texture network of maps, or the network of scans.

    \b
    bumpymap train textures --out textures.onnx
    bumpymap train scans Rellis-3D --out scan.onnx
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped


_NETWORK = (
    GroupedOption(["--out"], required=True, type=FILE, metavar="FILE", help="ONNX file to write.", group="Output"),
    GroupedOption(["--overwrite"], is_flag=True, help="Replace the network of an earlier training.", group="Output"),
)


@job("textures", TrainSettings, settings_options(NetworkSettings, table="network"), _NETWORK)
def textures_command(run: Run, out: Path, overwrite: bool) -> None:
    """Train the texture network on synthetic terrain.

    No survey is needed. To resume an interrupted training after its last complete epoch, give the same command again.

    \b
    bumpymap train textures --out textures.onnx
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    _train(run, out, overwrite, lambda progress: _train_textures(run.changed(), out, progress), "map SURVEY")


@job("scans", ScanTrainSettings, _NETWORK)
@click.argument("folder", type=PATH, metavar="FOLDER")
def scans_command(run: Run, folder: Path, out: Path, overwrite: bool) -> None:
    """Train the scan network on labelled frames.

    FOLDER has the layout of RELLIS-3D. To resume an interrupted training after its last complete epoch, give the same
    command again.

    \b
    bumpymap train scans Rellis-3D --out scan.onnx
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    _train(run, out, overwrite, lambda progress: _train_scans(run.changed(), out, folder, progress), "scan FRAME")


command.add_command(textures_command)
command.add_command(scans_command)


def _train(
    run: Run,
    out: Path,
    overwrite: bool,
    work: Callable[[CommandProgress], "tuple[list[str], Evaluation | ScanEvaluation]"],
    use: str,
) -> None:
    """Train a network, unless ``out`` is taken, and print its accuracy, and the command that uses it."""
    _require_libraries()
    if out.suffix != ".onnx":
        raise UsageError(f"--out is {out}; its name must end in .onnx")
    if out.exists() and not overwrite:
        raise OutputError(f"{out} exists; give --overwrite to replace it, or another --out")
    note = "Give the same command again to continue after the last complete epoch."
    with interrupt_note(note), run.progress() as progress:
        lines, scores = work(progress)
    card = out.with_suffix(".md")
    lines += [
        f"{out} ({scores.parameters:,} trained numbers), {card}",
        f"use it with: bumpymap {use} --out DIR --set model={out}",
    ]
    run.show({"out": str(out), "card": str(card), "parameters": scores.parameters}, lines)


def _train_textures(options: dict[str, Any], out: Path, progress: CommandProgress) -> "tuple[list[str], Evaluation]":
    from bumpymap.lab import make_model

    scores = make_model(TrainSettings(**options), out, _Epochs(progress))
    lines = [
        f"accuracy on unseen seeds:                      {100 * scores.unseen.right:.2f} %",
        f"accuracy on surveys anew (as in the paper):    {100 * scores.augmented_copies.right:.2f} %",
    ]
    return lines, scores


def _train_scans(
    options: dict[str, Any], out: Path, folder: Path, progress: CommandProgress
) -> "tuple[list[str], ScanEvaluation]":
    from bumpymap.lab import make_scan_model

    scores = make_scan_model(ScanTrainSettings(**options), out, folder, _Epochs(progress), _show_sectors(progress))
    even = 100 * scores.every.even
    lines = [
        f"accuracy on {scores.scans} unseen scans, classes weighted evenly: {even:.2f} %",
        f"accuracy on all {scores.every.count:,} of their sectors:        {100 * scores.every.right:.2f} %",
    ]
    return lines, scores


def _show_sectors(progress: Progress) -> Callable[[int, int], None]:
    """Return a callback that shows a bar for each set of scans: for training and for testing."""

    def count(done: int, total: int) -> None:
        if done == 1:
            progress.start("cutting scans into sectors", total)
        progress.advance(1)

    return count


class _Epochs:
    """Reports each epoch of a training."""

    def __init__(self, progress: CommandProgress) -> None:
        self._progress, self._begun = progress, False

    def __call__(self, report: "EpochReport") -> None:
        """Count an epoch and report its result."""
        if not self._begun:
            self._progress.start("learning epochs", report.epochs)
            self._progress.advance(report.epoch - 1)
            self._begun = True
        self._progress.advance(1)
        text = (
            f"epoch {report.epoch}/{report.epochs}: loss {report.loss:.4f}, "
            f"accuracy while learning {100 * report.accuracy:.2f} %, {report.seconds:.1f} s"
        )
        self._progress.note(text, "epoch", **asdict(report))


def _require_libraries() -> None:
    """Raise UsageError if a library is missing, before the hours of work."""
    if missing := [name for name in ("torch", "onnx") if find_spec(name) is None]:
        raise UsageError(f"training needs {' and '.join(missing)}. Install with: {install_command('learn')}")
