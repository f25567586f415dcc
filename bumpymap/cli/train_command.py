"""``bumpymap train``: train the texture network."""

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bumpymap.errors import UsageError

if TYPE_CHECKING:
    from bumpymap.learn.train import EpochReport

__all__ = ["command"]


@click.command("train")
@click.option(
    "--out",
    required=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="ONNX file to write; the model card goes beside it (.md).",
)
@click.option(
    "--seed", default=1, show_default=True, help="Decides the patches, the alterations and the first weights."
)
@click.option("--epochs", default=30, show_default=True, help="Times that every patch is learned from.")
@click.option("--patches-per-texture", default=6534, show_default=True, help="Training patches of each of the four.")
@click.option("--tile-size", default=3.0, show_default=True, help="Side of the tiles it is for, m.")
@click.option("--pixels", default=15, show_default=True, help="Pixels along a side of a tile.")
@click.option("--threads", default=1, show_default=True, help="CPU threads; part of what decides the last bits.")
def command(
    *, out: Path, seed: int, epochs: int, patches_per_texture: int, tile_size: float, pixels: int, threads: int
) -> None:
    """Train the texture network on made-up terrain and write it as ONNX.

    Needs no survey. Interrupted, the same command goes on from its last whole epoch.
    """
    _require_learn()
    from bumpymap.learn.make import make_model
    from bumpymap.learn.model import NetworkSettings
    from bumpymap.learn.train import TrainSettings

    if out.suffix != ".onnx":
        raise UsageError(f"--out is {out}; its name must end in .onnx")
    settings = TrainSettings(
        seed=seed,
        epochs=epochs,
        patches_per_texture=patches_per_texture,
        tile_size=tile_size,
        threads=threads,
        network=NetworkSettings(pixels=pixels),
    )
    made = make_model(settings, out, _print_epoch)
    scores = made.evaluation
    click.echo(f"accuracy on unseen seeds, all alterations:    {100 * scores.unseen.accuracy:.2f} %")
    click.echo(f"accuracy on altered copies (as in the paper): {100 * scores.altered_copies.accuracy:.2f} %")
    click.echo(f"{made.model} ({made.parameters:,} trained numbers), {made.card}")
    click.echo(f"use it with: bumpymap map SURVEY --out DIR --model {made.model}")


def _print_epoch(report: "EpochReport") -> None:
    click.echo(
        f"epoch {report.epoch}/{report.epochs}: loss {report.loss:.4f}, "
        f"accuracy while learning {100 * report.accuracy:.2f} %, {report.seconds:.1f} s",
        err=True,
    )


def _require_learn() -> None:
    missing = [name for name in ("torch", "onnx") if find_spec(name) is None]
    if missing:
        raise UsageError(f"training needs {' and '.join(missing)}. Install with: pip install 'bumpymap[learn]'")
