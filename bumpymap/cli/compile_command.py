"""``bumpymap compile``: compile the numerical kernels and the templates of pages, once."""

import click

from bumpymap.cli._options import GroupedCommand, output_options
from bumpymap.cli._progress import show_progress
from bumpymap.core import OutputError

__all__ = ["command"]


@click.command("compile", cls=GroupedCommand)
@output_options()
def command(*, quiet: bool, log_json: bool) -> None:
    """Compile the numerical kernels, and the templates of pages, now and once, not in the first run that needs them."""
    from bumpymap.views import compile_pages
    from bumpytiles import compile_packages

    with show_progress(quiet=quiet, as_json=log_json):
        kept = compile_packages("bumpymap", "bumpytiles")
        compile_pages()
    if not kept:
        folder = "a folder of your own that nobody else can write to"
        raise OutputError(f"the compiled kernels cannot be kept. Set NUMBA_CACHE_DIR to {folder}")
