"""``bumpymap report``: the page of a map again, or of two maps side by side."""

from pathlib import Path
from typing import Any

import click

from bumpymap.cli._options import PATH, Run, grouped_option, job
from bumpymap.core import UsageError

__all__ = ["command"]


@job("report", quiet="Print nothing.")
@click.argument("layers", nargs=-1, type=PATH, metavar="LAYERS...")
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
def command(run: Run, layers: tuple[Path, ...], **settings: Any) -> None:
    """Make the page of a map again, or compare two maps in one page. LAYERS are folders of `bumpymap map`.

    For one folder of `bumpymap diff`, the page of what has changed is made again.

    \b
    bumpymap report layers --route way
    bumpymap report layers --check checked
    bumpymap report may_layers june_layers --out may_and_june.html
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    if not layers:
        raise UsageError("no layers given: name the folder that `bumpymap map` wrote")
    from bumpymap.views import write_reports

    path = write_reports(layers, **settings)
    run.show({"report": str(path), "bytes": path.stat().st_size}, [f"Open {path} in a browser."])
