"""``bumpymap map``: make roughness layers and a cost map from surveys; slow libraries start beside other work."""

import threading
from contextlib import suppress

import click

from bumpymap.cli._options import PATH, Run, job
from bumpymap.core import CLASHES, MapConfig, Progress, with_pixels


class ImportsAhead:
    """A `Progress` that imports in a thread what rates tiles and writes layers, when its first stage begins.

    Before that the interpreter is busy; from then on it mostly waits for decoder and compiled code. pandas is hidden,
    see `import_without_pandas`, so this is for a process that only runs one command.
    """

    def __init__(self, progress: Progress) -> None:
        self._progress, self._begun = progress, False

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage."""
        if not self._begun:
            self._begun = True
            with suppress(RuntimeError):  # no thread can be started: they are imported when they are needed
                threading.Thread(target=_import, name="imports").start()
        self._progress.start(stage, total)

    def advance(self, steps: int) -> None:
        """Report that ``steps`` more steps are done."""
        self._progress.advance(steps)


def _import() -> None:
    with suppress(Exception):  # whoever needs it tries again, and says what is wrong
        from bumpymap.core import onnx_runtime
        from bumpymap.layers import import_without_pandas

        onnx_runtime()
        import_without_pandas("pyogrio.raw", "bumpymap.layers.folder", "bumpymap.views.gis.project", "jinja2")


@job("map", MapConfig, clashes=CLASHES)
@click.argument("surveys", nargs=-1, type=PATH, metavar="SURVEY...")
def command(run: Run) -> None:
    """Make roughness layers and a cost map from SURVEY files or folders (LAS, LAZ, COPC, PLY, PCD).

    \b
    bumpymap map site.laz --out site_layers
    bumpymap map flight_1.laz flight_2.laz --out layers --crs EPSG:32614
    bumpymap map site.laz --out layers --vehicle my_robot.toml --set pixels=21
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    config = MapConfig(**with_pixels(run.required(surveys="site.laz", out="--out DIR")))
    if run.ctx.obj:  # this process runs nothing else
        from bumpymap.readers import start_decoder

        start_decoder(config.surveys)  # LAZ is decoded by a process of its own, which starts on another core
    from bumpymap.survey import map_surveys, require_known

    with run.progress() as progress:
        result = map_surveys(config, ImportsAhead(progress) if run.ctx.obj else progress)
    from bumpymap.cli._summary import map_lines, map_record

    run.show(map_record(result, config), map_lines(result, config))
    require_known(result, config, explain=run.quiet or run.as_json)
    if result.skipped:
        run.end_partly_done()
