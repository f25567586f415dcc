"""Fill the reference of commands from the commands themselves, when the pages are built (a hook of MkDocs).

``<!-- help NAME -->`` becomes the help page of a command, ``<!-- settings NAME -->`` its settings file.
"""

import re
import shlex
from typing import Any

from click.testing import CliRunner

from bumpymap.cli import main


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return a page with its markers replaced."""
    return re.sub(r"^<!-- (help|settings) ([a-z ]+) -->$", _filled, markdown, flags=re.MULTILINE)


def _filled(marker: re.Match[str]) -> str:
    """Return what the command prints, in a block."""
    kind, name = marker.groups()
    words, language = ([*shlex.split(name), "--help"], "text") if kind == "help" else (["settings", name], "toml")
    printed = CliRunner().invoke(main, words, prog_name="bumpymap")
    if printed.exit_code:
        raise ValueError(f"{marker[0]}: {printed.output}")
    return f"```{language}\n{printed.stdout.strip()}\n```"
