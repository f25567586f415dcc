"""What the commands share: paths of the command line, and what to say where a run is ended."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from bumpymap.core import why_no_path

__all__ = ["DRIVES_KEPT", "FILE", "LOCATION", "PATH", "interrupt_note"]

DRIVES_KEPT = "The driven patches are kept: give the same command again to continue."


class _NamedPath(click.Path):
    """A path that is not the empty text: an unset shell variable must not mean the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Turn a text into a Path."""
        if value == "":
            self.fail("the path is empty; is a variable unset? The current folder is called .", param, ctx)
        if isinstance(value, str) and (reason := why_no_path(value)):
            self.fail(reason, param, ctx)
        return super().convert(value, param, ctx)


PATH = _NamedPath(path_type=Path)
"""Type of every path on the command line."""
FILE = _NamedPath(dir_okay=False, path_type=Path)
"""Of a path that must not be a folder."""


class _Location(_NamedPath):
    """A path, or the text of a URL, which stays a text."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Turn a text into a Path, unless it is a URL."""
        return value if isinstance(value, str) and "://" in value else super().convert(value, param, ctx)


LOCATION = _Location(path_type=Path)
"""Type of surveys on the command line."""


@contextmanager
def interrupt_note(note: str) -> Iterator[None]:
    """Say on Ctrl-C or SIGTERM what is kept; the group of commands prints it and exits."""
    try:
        yield
    except KeyboardInterrupt as end:
        end.add_note(note)
        raise
