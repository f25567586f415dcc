"""The pages about the command line: every option is described, every command that they show can be given."""

import re
import shlex
import tomllib
from pathlib import Path

import click
import pytest

from bumpymap.cli import main
from bumpymap.core.config import MapConfig
from bumpymap.core.settings import read_settings_file

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "pages"
OWN_PAGES = {
    "batch": "batch.md",
    "scan": "scans.md",
    "route": "routes.md",
    "diff": "diff.md",
    "check": "check.md",
}
COMMANDS = main.list_commands(click.Context(main))


def command(name):
    return main.get_command(click.Context(main), name)


def options(name):
    group = command(name)
    parts = group.commands.values() if isinstance(group, click.Group) else [group]
    given = [option for part in parts for parameter in part.params for option in parameter.opts]
    return {option for option in given if option.startswith("--")}


def section(name):
    """Return what the pages say about a command; some have pages of their own."""
    if name in OWN_PAGES:
        return (PAGES / OWN_PAGES[name]).read_text(encoding="utf-8").split("## Files")[0]
    text = (PAGES / "command-line.md").read_text(encoding="utf-8")
    found = re.search(rf"^## {name}\n(.*?)(?=^## )", text, re.DOTALL | re.MULTILINE)
    assert found, f"command-line.md has no section {name}"
    return found[1]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_described_and_no_other(name):
    rows = [line.split("|")[1] for line in section(name).splitlines() if line.startswith("|")]
    in_tables = set(re.findall(r"--[a-z][a-z-]*", " ".join(rows)))
    assert in_tables <= options(name)
    shown = set(re.findall(r"--[a-z][a-z-]*", section(name)))
    assert options(name) <= shown


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - {"batch", "vehicle"}))  # batch takes options as map does
def test_the_tables_name_the_defaults_of_the_declaration(name):
    rows = [line for line in section(name).splitlines() if line.startswith("|") and "as for `map`" not in line]
    for option in command(name).params:
        default = re.search(r"\[default: ([\d.]+)[\];]", getattr(option, "help", None) or "")
        own = [row for row in rows if re.search(rf"{option.opts[0]}[ `]", row)]
        if default and own:
            assert any(re.search(rf"\b{re.escape(default[1])}\b", row) for row in own), f"{option.opts[0]}: {own}"


def shown_commands():
    """Every line of the README and the pages that starts with bumpymap."""
    for page in (ROOT / "README.md", *sorted(PAGES.glob("*.md"))):
        for line in page.read_text(encoding="utf-8").splitlines():
            found = re.match(r"(?:    )?(?:\$ )?bumpymap ([a-z]+ .*)", line)
            if found and found[1].split()[0] in COMMANDS:
                yield pytest.param(found[1], id=f"{page.name}: {found[1]}")


@pytest.mark.parametrize("line", list(shown_commands()))
def test_every_command_that_is_shown_can_be_given(line):
    name, *words = shlex.split(line, comments=True)
    given = command(name)
    if isinstance(given, click.Group):
        given = given.commands[words.pop(0)]
    given.make_context(name, words)


def test_the_settings_of_the_page_are_settings(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", (PAGES / "command-line.md").read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "a.toml").write_text(text)
    config = MapConfig((), tmp_path, **read_settings_file(tmp_path / "a.toml", MapConfig))
    assert config.crs == "EPSG:32614"
    assert config.features == MapConfig((), tmp_path).features


def test_the_first_page_lists_the_extras():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    rows = re.findall(r"^\| `(\w+)` \| .* \| (.*) \|$", (PAGES / "index.md").read_text(encoding="utf-8"), re.MULTILINE)
    listed = {name: set(brings.split(", ")) for name, brings in rows}
    named = {name: {re.split(r"[\[>=]", wanted)[0] for wanted in wants} for name, wants in extras.items()}
    del named["all"]
    assert set(re.search(r"\[(.*)\]", extras["all"][0])[1].split(",")) == set(named)
    assert {name: listed[name] for name in named} == named
