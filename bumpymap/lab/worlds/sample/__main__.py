"""``python -m bumpymap.lab.worlds.sample``: write the sample survey."""

import sys
from pathlib import Path

import click

from bumpymap.core import BumpymapError
from bumpymap.lab.worlds.sample.files import make_quarry_survey


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--out", "folder", type=click.Path(path_type=Path), required=True, help="Folder to write to.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Another seed, another site.")
def make(folder: Path, seed: int) -> None:
    """Make a survey of a quarry that does not exist: quarry.laz and quarry_part.ply."""
    try:
        files = make_quarry_survey(folder, seed)
    except BumpymapError as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(error.exit_code)
    for path in (files.survey, files.part):
        click.echo(f"{path}  {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    make(prog_name="python -m bumpymap.lab.worlds.sample")
