"""``bumpymap demo``: map a synthetic survey as an example."""

import shutil
from itertools import chain
from pathlib import Path

import click

from bumpymap.cli._options import PATH, Run, job
from bumpymap.core import BadInputError, MapConfig, OutputError, atomic

__all__ = ["command"]

_SAMPLE = Path("sample_data") / "quarry.laz"
"""In an installed package it lies inside, in the sources beside it."""


@job("demo")
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
    help="Survey to map [default: a synthetic quarry, copied to DIR].",
)
def command(run: Run, out: Path, survey: Path | None) -> None:
    """Map a synthetic quarry as an example."""
    from bumpymap.cli._summary import map_lines, map_record
    from bumpymap.layers import REPORT_NAME
    from bumpymap.survey import map_surveys

    if survey is None:
        survey = _copy_sample(out / "survey" / _SAMPLE.name)
    config = MapConfig(surveys=(survey,), out=out / "layers", overwrite=True)
    with run.progress() as progress:
        result = map_surveys(config, progress)
    look = [f"Open {config.out / 'map.qgs'} in QGIS, or the layers in any other GIS."]
    look += [f"Open {config.out / REPORT_NAME} in a browser."]
    run.show(map_record(result, config), chain([f"Mapped {survey}"], map_lines(result, config), look))


def _copy_sample(survey: Path) -> Path:
    """Copy the sample survey and return the copy."""
    package = Path(__file__).resolve().parents[1]
    found = [path for path in (package / _SAMPLE, package.parent / _SAMPLE) if path.is_file()]
    if not found:
        raise BadInputError(f"{package / _SAMPLE} is missing: install bumpymap again, or give --survey FILE")
    try:
        survey.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write the survey to {survey.parent}: {error}. Choose another --out") from error
    with atomic(survey) as beside:
        shutil.copyfile(found[0], beside)
    return survey
