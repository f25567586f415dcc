"""``bumpymap compile``: compile the numerical kernels and the templates of pages, once."""

from bumpymap.cli._options import Run, job
from bumpymap.core import OutputError

__all__ = ["command"]


@job("compile")
def command(run: Run) -> None:
    """Compile the numerical kernels, and the templates of pages, now and once, not in the first run that needs them."""
    from bumpymap.views import compile_pages
    from bumpytiles import compile_packages

    with run.progress():
        kept = compile_packages("bumpymap", "bumpytiles")
        compile_pages()
    if not kept:
        folder = "a folder of your own that nobody else can write to"
        raise OutputError(f"the compiled kernels cannot be kept. Set NUMBA_CACHE_DIR to {folder}")
