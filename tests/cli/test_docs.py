"""The pages about the command line: every option is described, every command that they show can be given."""

import importlib.util
import re
import shlex
import tomllib
from pathlib import Path

import click
import pytest

from bumpymap.cli import main
from bumpymap.core import BANDS
from bumpymap.core.config import MapConfig
from bumpymap.core.settings import read_settings_file
from bumpymap.layers.scan_table import COLUMNS

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "pages"
COMMANDS = main.list_commands(click.Context(main))


def command(name):
    return main.get_command(click.Context(main), name)


def test_the_reference_shows_the_help_of_every_command():
    page = (PAGES / "command-line.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"^<!-- help ([a-z ]+) -->$", page, re.MULTILINE))
    parts = {f"{name} {part}" for name in ("evaluate", "train") for part in command(name).commands}
    assert shown == set(COMMANDS) - {"evaluate", "train"} | parts | {"vehicle new"}


def test_the_reference_is_filled_from_the_declarations():
    spec = importlib.util.spec_from_file_location("reference", ROOT / "docs" / "reference.py")
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    filled = "".join(
        reference.on_page_markdown(page.read_text(encoding="utf-8")) for page in sorted(PAGES.glob("*.md"))
    )
    assert not re.search("<!-- (help|settings|bands|columns|profile|vehicles|include)", filled)
    for number, band in enumerate(BANDS, start=1):
        assert f"| {number} | `{band.name}` | {band.unit} | {band.description} |" in filled
        assert f"| `{band.name}` | " in filled
    assert all(f"| `{name}` | " in filled for name, *_ in COLUMNS)
    assert "| `chassis.com_height_m` | m | -2 to 6 | height of the centre of mass" in filled
    assert re.search(r"\| `rocker.stiffness_nm_per_rad` \| 120000 \| 5000 \| 300 \| 10000 \|", filled)
    assert "| affine | BSD | default |" in filled
    assert re.search(r"--tile-size M +Side of a tile, in metres \[3\]\.", filled)
    assert "#pixels = 15" in filled


def shown_commands():
    """Every line of the README and the pages that starts with bumpymap."""
    for page in (ROOT / "README.md", *sorted(PAGES.glob("*.md"))):
        for line in page.read_text(encoding="utf-8").splitlines():
            found = re.match(r"(?:    )?(?:\$ )?bumpymap ([a-z]+ .*)", line)
            if found and found[1].split()[0] in COMMANDS:
                yield pytest.param(found[1], id=f"{page.name}: {found[1]}")


@pytest.mark.parametrize("line", list(shown_commands()))
def test_every_command_that_is_shown_can_be_given(line):
    name, *words = shlex.split(re.sub(r" > \S+", "", line), comments=True)
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
