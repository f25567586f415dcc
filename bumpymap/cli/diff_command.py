"""``bumpymap diff``: what has changed between two surveys of a site."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from bumpymap.change import DiffConfig
from bumpymap.cli._options import PATH, Run, job
from bumpymap.cli._text import Table
from bumpymap.core import count_text, share_text, shares_text

if TYPE_CHECKING:
    from bumpymap.change import ChangeResult


def _names() -> tuple[str, ...]:
    from bumpymap.core import CLASS_NAMES

    return (*(f"{number} {name}" for number, name in enumerate(CLASS_NAMES)), "unknown")


def _lines(result: "ChangeResult", config: DiffConfig) -> Iterator[str | Table]:
    counts = result.counts
    yield (
        f"{count_text(counts['in_both'], 'tile is', 'tiles are')} in both surveys, {counts['compared']:,} compared, "
        f"{counts['changed']:,} changed ({share_text(counts['changed'] / max(counts['compared'], 1), 1)}) in "
        f"{count_text(counts['regions'], 'place')}"
    )
    yield Table(_changes(result), ("change", "tiles", "share"))
    yield "Classes before (rows) and after (columns), tiles:"
    rows = ((name, *(f"{tiles:,}" for tiles in row)) for name, row in zip(_names(), result.transitions, strict=True))
    yield Table(rows, ("before", *_names()))
    if counts["passable_lost"] or counts["passable_won"]:
        yield (
            f"of the changed tiles, {count_text(counts['passable_lost'], 'is', 'are')} no longer passable and "
            f"{count_text(counts['passable_won'], 'is', 'are')} now"
        )
    yield from result.notes
    if config.out is not None:
        yield f"Files in {config.out}: {', '.join(path.name for path in result.files)}"


def _changes(result: "ChangeResult") -> Iterator[tuple[str, ...]]:
    tiles = result.counts["by_change"]
    for (text, count), share in zip(tiles.items(), shares_text(list(tiles.values()), (0,), 1), strict=True):
        yield text, f"{count:,}", share


def _record(result: "ChangeResult", config: DiffConfig) -> dict[str, Any]:
    return {
        "out": None if config.out is None else str(config.out),
        "files": [path.name for path in result.files],
        "counts": dict(result.counts),
        "classes": {"names": list(_names()), "tiles_before_after": result.transitions.tolist()},
        "fit": dict(result.fit),
        "notes": list(result.notes),
    }


@job("diff", DiffConfig)
@click.argument("before", type=PATH, metavar="BEFORE")
@click.argument("after", type=PATH, metavar="AFTER")
def command(run: Run) -> None:
    """Find what has changed between two surveys of a site, BEFORE and AFTER: folders of `bumpymap map`.

    \b
    bumpymap diff may_layers june_layers --out may_to_june
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.change import find_changes

    config = DiffConfig(**run.settings)
    with run.progress() as progress:
        result = find_changes(config, progress)
    run.show(_record(result, config), _lines(result, config))
