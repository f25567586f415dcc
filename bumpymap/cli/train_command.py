"""``bumpymap train``: train the texture network, or with ``--scans`` the network for the sectors of scans."""

from collections.abc import Callable
from dataclasses import asdict, fields
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bumpymap.cli._options import FILE, Run, grouped_option, job, settings_options
from bumpymap.cli._progress import CommandProgress
from bumpymap.cli._text import interrupt_note, option_name
from bumpymap.core import OutputError, Progress, UsageError
from bumpymap.lab import LoopSettings, NetworkSettings, ScanTrainSettings, TrainSettings

if TYPE_CHECKING:
    from bumpymap.lab import EpochReport, TrainedModel

__all__ = ["command"]


@job(
    "train",
    settings_options(LoopSettings),
    settings_options(TrainSettings, "patches_per_texture", "tile_size"),
    settings_options(NetworkSettings, "pixels", table="network"),
    settings_options(ScanTrainSettings, "sectors_per_class"),
    owners=(TrainSettings, ScanTrainSettings),
)
@grouped_option("--out", required=True, type=FILE, metavar="FILE", help="ONNX file to write.", group="Output")
@grouped_option(
    "--scans",
    metavar="DIR",
    help="Train the network of `bumpymap scan` on labelled frames: a folder in the layout of RELLIS-3D.",
    group="Input",
)
@grouped_option("--overwrite", is_flag=True, help="Replace the network of an earlier training.", group="Output")
def command(run: Run, out: Path, scans: str | None, overwrite: bool) -> None:
    """Train the texture network on synthetic terrain and write it as ONNX; no survey is needed.

    With --scans, train the scan network instead. To resume an interrupted training after its last complete epoch, give
    the same command again.

    \b
    bumpymap train --out textures.onnx
    bumpymap train --scans Rellis-3D --out scan.onnx
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    options = run.changed(TrainSettings if scans is None else ScanTrainSettings, *run.owners)
    _refuse_other_options(options, scans)
    _require_libraries()
    if out.suffix != ".onnx":
        raise UsageError(f"--out is {out}; its name must end in .onnx")
    if out.exists() and not overwrite:
        raise OutputError(f"{out} exists; give --overwrite to replace it, or another --out")
    note = "Give the same command again to continue after the last complete epoch."
    with interrupt_note(note), run.progress() as progress:
        if scans is None:
            lines, made = _train_textures(options, out, progress)
        else:
            lines, made = _train_scans(options, out, Path(scans), progress)
    run.show({"out": str(made.model), "card": str(made.card), "parameters": made.parameters}, lines)


def _refuse_other_options(options: dict[str, Any], scans: str | None) -> None:
    """Raise UsageError for options of the other network, which would have no effect."""
    names = {field.name for field in fields(TrainSettings if scans is None else ScanTrainSettings)}
    own = names if scans is None else names - {"network"}  # the file's table is that of the texture network
    foreign = [option_name(name) for name in options if name not in own]
    if foreign and scans is None:
        raise UsageError(f"{foreign[0]} applies to scans: add --scans DIR, or leave it out")
    if foreign:
        raise UsageError(f"{foreign[0]} applies to the texture network and has no effect with --scans: leave it out")
    if scans is not None and not scans.strip():
        raise UsageError("--scans is empty; is a variable unset? Give a folder in the layout of RELLIS-3D")


def _train_textures(
    options: dict[str, Any], out: Path, progress: CommandProgress
) -> "tuple[list[str], TrainedModel[Any]]":
    from bumpymap.lab import make_model

    made = make_model(TrainSettings(**options), out, _Epochs(progress))
    scores = made.evaluation
    lines = [
        f"accuracy on unseen seeds, all alterations:    {100 * scores.unseen.accuracy:.2f} %",
        f"accuracy on altered copies (as in the paper): {100 * scores.augmented_copies.accuracy:.2f} %",
        f"{made.model} ({made.parameters:,} trained numbers), {made.card}",
        f"use it with: bumpymap map SURVEY --out DIR --set model={made.model}",
    ]
    return lines, made


def _train_scans(
    options: dict[str, Any], out: Path, folder: Path, progress: CommandProgress
) -> "tuple[list[str], TrainedModel[Any]]":
    from bumpymap.lab import make_scan_model

    made = make_scan_model(ScanTrainSettings(**options), out, folder, _Epochs(progress), _show_sectors(progress))
    scores = made.evaluation
    even = 100 * scores.every.balanced_accuracy
    lines = [
        f"accuracy on {scores.scans} unseen scans, classes weighted evenly: {even:.2f} %",
        f"accuracy on all {scores.every.count:,} of their sectors:        {100 * scores.every.accuracy:.2f} %",
        f"{made.model} ({made.parameters:,} trained numbers), {made.card}",
        f"use it with: bumpymap scan FRAME --out DIR --set model={made.model}",
    ]
    return lines, made


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
        raise UsageError(f"training needs {' and '.join(missing)}. Install with: pip install 'bumpymap[learn]'")
