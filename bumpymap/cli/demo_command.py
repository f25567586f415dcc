"""``bumpymap demo``: a first map in a minute."""

from pathlib import Path

import click

from bumpymap.cli._terminal import PATH, BarProgress, set_up_logging
from bumpymap.config import MapConfig

__all__ = ["command"]


@click.command("demo")
@click.option("--out", default="demo_out", type=PATH, metavar="DIR", show_default=True)
@click.option(
    "--survey",
    type=PATH,
    metavar="FILE",
    help="Survey to map; without it a made-up quarry is generated into DIR.",
)
def command(out: Path, survey: Path | None) -> None:
    """Map a made-up quarry and say where the layers are: see what bumpymap writes."""
    from bumpymap.cli._summary import show
    from bumpymap.pipeline import map_surveys

    set_up_logging(as_json=False)
    if survey is None:
        from bumpymap.sample import make_quarry_survey

        survey = make_quarry_survey(out / "survey").survey
    config = MapConfig(surveys=(survey,), out=out / "layers", overwrite=True)
    with BarProgress() as progress:
        result = map_surveys(config, progress)
    click.echo(f"Mapped {survey}")
    show(result, config, as_json=False)
    click.echo(f"Open {config.out / 'class.tif'} or {config.out / 'cost.geojson'} in QGIS or any other GIS.")
