"""``python -m bumpymap.lab.worlds.sample``: write the sample survey. Prints nothing unless it fails."""

from argparse import ArgumentDefaultsHelpFormatter, ArgumentParser
from collections.abc import Sequence
from pathlib import Path

from bumpymap.core import BumpymapError
from bumpymap.lab.worlds.sample.files import make_quarry_survey

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Write quarry.laz and quarry_part.ply; ``arguments`` default to those of the process."""
    parser = ArgumentParser(
        "python -m bumpymap.lab.worlds.sample",
        description="Make a survey of a synthetic quarry: quarry.laz and quarry_part.ply.",
        formatter_class=ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="0 or more; determines the site")
    given = parser.parse_args(arguments)
    if given.seed < 0:
        parser.error(f"--seed is {given.seed}; it must be 0 or more")
    try:
        make_quarry_survey(given.out, given.seed)
    except BumpymapError as error:
        parser.exit(error.exit_code, f"Error: {error}\n")


if __name__ == "__main__":
    main()
