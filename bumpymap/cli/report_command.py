"""``bumpymap report``: the page of a map again."""

from pathlib import Path
from typing import Any

import click

from bumpymap.cli._options import PATH, GroupedCommand, given_options, grouped_option, output_options
from bumpymap.cli._text import print_json, print_line

__all__ = ["command"]


@click.command("report", cls=GroupedCommand)
@click.argument("layers", type=PATH)
@grouped_option("--out", group="Output", type=PATH, metavar="FILE", help="File to write [LAYERS/report.html].")
@grouped_option(
    "--route",
    group="Input",
    type=PATH,
    metavar="PATH",
    help="Draw ways: the folder of `bumpymap route`, or route.geojson.",
)
@grouped_option(
    "--check", group="Input", type=PATH, metavar="DIR", help="Show the drives that `bumpymap check` wrote there."
)
@grouped_option("--overwrite", group="Output", is_flag=True, help="Replace FILE if it exists.")
@output_options("Print nothing.")
def command(*, layers: Path, quiet: bool, log_json: bool, **given: Any) -> None:
    """Make the page of a map again. LAYERS is a folder of `bumpymap map`.

    For a folder of `bumpymap diff`, the page of what has changed is made again.

    \b
    bumpymap report layers --route way
    bumpymap report layers --check checked
    bumpymap report layers --out site.html
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.views import write_report

    path = write_report(layers, **given_options(given))
    if quiet:
        return
    if log_json:
        print_json({"report": str(path), "bytes": path.stat().st_size})
    else:
        print_line(f"Open {path} in a browser.")
