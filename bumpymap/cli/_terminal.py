"""Types of paths on the command line, and the note that says how to resume a command."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from bumpymap.core import parse_share, path_fault

__all__ = ["DRIVES_KEPT", "FILE", "LOCATION", "PATH", "SHARE", "NumberList", "interrupt_note"]

DRIVES_KEPT = "The driven patches are kept: give the same command again to continue."


class _NamedPath(click.Path):
    """A path that is not empty: an unset shell variable must not mean the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert a string to a Path."""
        if value == "":
            self.fail("the path is empty; is a variable unset? The current folder is called .", param, ctx)
        if isinstance(value, str) and (reason := path_fault(value)):
            self.fail(reason, param, ctx)
        if isinstance(value, str) and "://" in value:
            self.fail(f"{value} is a URL; URLs can be surveys, and the --out of batch", param, ctx)
        return super().convert(value, param, ctx)


PATH = _NamedPath(path_type=Path)
"""Type of every path on the command line."""
FILE = _NamedPath(dir_okay=False, path_type=Path)
"""Type of a path that must not be a folder."""


class _Location(_NamedPath):
    """A path, or a URL, which stays a string."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert a string to a Path, unless it is a URL."""
        return value if isinstance(value, str) and "://" in value else super().convert(value, param, ctx)


LOCATION = _Location(path_type=Path)
"""Type of surveys on the command line."""


class _Share(click.ParamType):  # type: ignore[type-arg]
    """A share, as a number from 0 to 1 or as a percentage."""

    name = "share"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Convert a string to a number from 0 to 1."""
        share = parse_share(str(value))
        if share is None:
            self.fail(f"{value!r} is no share; give one such as 50% or 0.5", param, ctx)
        return share


SHARE = _Share()
"""Type of a share on the command line."""


class NumberList(click.ParamType):  # type: ignore[type-arg]
    """Numbers with commas between them."""

    name = "list"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Convert a string to numbers."""
        try:
            return tuple(float(word) for word in str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} is no list of numbers; give one such as 1,2,5", param, ctx)


@contextmanager
def interrupt_note(note: str) -> Iterator[None]:
    """Add a note to the message after Ctrl-C or SIGTERM."""
    try:
        yield
    except KeyboardInterrupt as end:
        end.add_note(note)
        raise
