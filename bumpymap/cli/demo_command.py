"""``bumpymap demo``: map a synthetic survey as an example."""

from pathlib import Path

import click

from bumpymap.cli._options import PATH, output_options
from bumpymap.cli._progress import show_progress
from bumpymap.cli._text import print_line
from bumpymap.core import MapConfig

__all__ = ["command"]


@click.command("demo")
@click.option(
    "--out",
    default="demo_out",
    type=PATH,
    metavar="DIR",
    show_default=True,
    help="Folder for the survey and the layers.",
)
@click.option(
    "--survey",
    type=PATH,
    metavar="FILE",
    help="Survey to map [default: a synthetic quarry, generated in DIR].",
)
@output_options()
def command(out: Path, survey: Path | None, *, quiet: bool, log_json: bool) -> None:
    """Map a synthetic quarry as an example."""
    from bumpymap.cli._summary import show
    from bumpymap.layers import REPORT_NAME
    from bumpymap.survey import map_surveys

    if survey is None:
        from bumpymap.lab import make_quarry_survey

        survey = make_quarry_survey(out / "survey").survey
    config = MapConfig(surveys=(survey,), out=out / "layers", overwrite=True)
    with show_progress(quiet=quiet, as_json=log_json) as progress:
        result = map_surveys(config, progress)
    if quiet:
        return
    if log_json:
        show(result, config, as_json=True)
        return
    print_line(f"Mapped {survey}")
    show(result, config, as_json=False)
    print_line(f"Open {config.out / 'map.qgs'} in QGIS, or the layers in any other GIS.")
    print_line(f"Open {config.out / REPORT_NAME} in a browser.")
