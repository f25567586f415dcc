"""``bumpymap compile``: compile the numerical kernels, once."""

import click

from bumpymap.cli._options import output_options
from bumpymap.cli._progress import show_progress
from bumpymap.core import OutputError

__all__ = ["command"]


@click.command("compile")
@output_options()
def command(*, quiet: bool, log_json: bool) -> None:
    """Compile the numerical kernels now, once, instead of in the first run that needs them."""
    from bumpytiles import compile_packages

    with show_progress(quiet=quiet, as_json=log_json):
        kept = compile_packages("bumpymap", "bumpytiles")
    if not kept:
        folder = "a folder of your own that nobody else can write to"
        raise OutputError(f"the compiled kernels cannot be kept. Set NUMBA_CACHE_DIR to {folder}")
