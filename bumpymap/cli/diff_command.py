"""``bumpymap diff``: what has changed between two surveys of a site."""

from pathlib import Path
from typing import Any

import click

from bumpymap.cli._events import set_up_logging
from bumpymap.cli._options import given_options, output_options
from bumpymap.cli._progress import show_progress
from bumpymap.cli._terminal import PATH

__all__ = ["command"]


@click.command("diff")
@click.argument("before", type=PATH, metavar="BEFORE")
@click.argument("after", type=PATH, metavar="AFTER")
@click.option("--out", type=PATH, metavar="DIR", help="Folder for the files: raster, places, page.")
@click.option("--fdr", type=float, metavar="SHARE", help="Share of changed tiles found by mistake [default: 0.05].")
@click.option("--min-tiles", type=int, metavar="N", help="Fewest connected tiles of a change [default: 2].")
@click.option("--offset", type=float, metavar="M", help="Height to take off AFTER [default: as measured].")
@click.option("--overwrite", is_flag=True, help="Replace the files of an earlier run.")
@output_options()
def command(before: Path, after: Path, *, quiet: bool, log_json: bool, **given: Any) -> None:
    """Find what has changed between two surveys of a site, BEFORE and AFTER: folders of `bumpymap map`.

    \b
    bumpymap diff may_layers june_layers --out may_to_june
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    set_up_logging(as_json=log_json)
    from bumpymap.change import DiffConfig, find_changes

    config = DiffConfig(before, after, **given_options(given))
    with show_progress(quiet=quiet, as_json=log_json) as progress:
        result = find_changes(config, progress)
    if not quiet:
        from bumpymap.cli._diff_summary import show

        show(result, config, as_json=log_json)
