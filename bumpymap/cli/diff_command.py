"""``bumpymap diff``: what has changed between two surveys of a site."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.change import DiffConfig
from bumpymap.cli._options import PATH, GroupedCommand, config_options, given_options, output_options, settings_options
from bumpymap.cli._progress import show_progress
from bumpymap.cli._text import print_json, print_line, print_table
from bumpymap.core import count_text, share_text, shares_text

if TYPE_CHECKING:
    from bumpymap.change import ChangeResult

__all__ = ["command", "show"]


def _names() -> tuple[str, ...]:
    from bumpymap.core import CLASS_NAMES

    return (*(f"{number} {name}" for number, name in enumerate(CLASS_NAMES)), "unknown")


def show(result: "ChangeResult", config: DiffConfig, *, as_json: bool) -> None:
    """Print what has changed as tables, or as one JSON object."""
    if as_json:
        print_json(_record(result, config))
        return
    counts = result.counts
    print_line(
        f"{count_text(counts['in_both'], 'tile is', 'tiles are')} in both surveys, {counts['compared']:,} compared, "
        f"{counts['changed']:,} changed ({share_text(counts['changed'] / max(counts['compared'], 1), 1)}) in "
        f"{count_text(counts['regions'], 'place')}"
    )
    print_table(_changes(result), ("change", "tiles", "share"))
    print_line("Classes before (rows) and after (columns), tiles:")
    print_table(_classes(result), ("before", *_names()))
    if counts["passable_lost"] or counts["passable_won"]:
        print_line(
            f"of the changed tiles, {count_text(counts['passable_lost'], 'is', 'are')} no longer passable and "
            f"{count_text(counts['passable_won'], 'is', 'are')} now"
        )
    for line in result.notes:
        print_line(line)
    if config.out is not None:
        print_line(f"Files in {config.out}: {', '.join(path.name for path in result.files)}")


def _changes(result: "ChangeResult") -> Iterator[tuple[str, ...]]:
    tiles = result.counts["by_change"]
    for (text, count), share in zip(tiles.items(), shares_text(list(tiles.values()), (0,), 1), strict=True):
        yield text, f"{count:,}", share


def _classes(result: "ChangeResult") -> Iterator[tuple[str, ...]]:
    for name, row in zip(_names(), result.transitions, strict=True):
        yield name, *(f"{tiles:,}" for tiles in row)


def _record(result: "ChangeResult", config: DiffConfig) -> dict[str, Any]:
    return {
        "out": None if config.out is None else str(config.out),
        "files": [path.name for path in result.files],
        "counts": dict(result.counts),
        "classes": {"names": list(_names()), "tiles_before_after": result.transitions.tolist()},
        "fit": dict(result.fit),
        "notes": list(result.notes),
    }


@click.command("diff", cls=GroupedCommand)
@click.argument("before", type=PATH, metavar="BEFORE")
@click.argument("after", type=PATH, metavar="AFTER")
@settings_options(DiffConfig)
@config_options(DiffConfig)
@output_options()
def command(before: Path, after: Path, *, stored: dict[str, Any], quiet: bool, log_json: bool, **given: Any) -> None:
    """Find what has changed between two surveys of a site, BEFORE and AFTER: folders of `bumpymap map`.

    \b
    bumpymap diff may_layers june_layers --out may_to_june
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.change import find_changes

    config = DiffConfig(**{**stored, **given_options(given), "before": before, "after": after})
    with show_progress(quiet=quiet, as_json=log_json) as progress:
        result = find_changes(config, progress)
    if not quiet:
        show(result, config, as_json=log_json)
