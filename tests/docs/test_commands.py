"""Every command of README.md and the pages runs, or its rule says why it does not; see ``commands.py`` beside this."""

import importlib.util
import re
import shutil
import sys
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

from bumpymap.cli import main

pytestmark = pytest.mark.slow

_spec = importlib.util.spec_from_file_location("docs_commands", Path(__file__).with_name("commands.py"))
commands = sys.modules["docs_commands"] = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(commands)

SHOWN = [(page.name, command) for page in commands.PAGES for command in commands.shown(page)]
PAGES = sorted({page for page, command in SHOWN if commands.rule_of(command) is None})


def test_commands_are_found():
    assert ("README.md", "make demo") in SHOWN
    assert ("scans.md", "bumpymap scan frame.pcd --out out") in SHOWN
    assert len(SHOWN) > 40


@pytest.fixture(scope="module")
def furnished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("furnished")
    commands.furnish(folder)
    return folder


@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_run_one_after_the_other(page, furnished, tmp_path, monkeypatch):
    folder = shutil.copytree(furnished, tmp_path / "page")
    monkeypatch.chdir(folder)
    for where, command in SHOWN:
        if where != page or commands.rule_of(command) is not None:
            continue
        program, *words = commands.filled(command)
        assert program == "bumpymap", f"no rule says what to do with: {command}"
        done = CliRunner().invoke(main, words)
        assert done.exit_code == 0, f"{command}\n{done.output}"


@pytest.mark.parametrize("page", sorted({page for page, _ in SHOWN}))
def test_no_command_of_a_page_is_in_the_way_of_a_later_one(page):
    outs = [
        words[words.index("--out") + 1]
        for where, command in SHOWN
        if where == page and "--overwrite" not in (words := command.split()) and "--out" in words
    ]
    assert len(outs) == len(set(outs)), f"two commands write to the same --out: {outs}"


@pytest.mark.parametrize("rule", commands.RULES, ids=lambda rule: rule.pattern)
def test_every_rule_is_of_use(rule):
    assert [command for _, command in SHOWN if commands.rule_of(command) is rule]


def test_what_does_not_run_names_extras_targets_and_scripts_that_are_there():
    root = commands.ROOT
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    targets = re.findall(r"(?m)^([a-z-]+):", (root / "Makefile").read_text(encoding="utf-8"))
    for page, command in SHOWN:
        for extras in re.findall(r"bumpymap\[([^\]]*)\]", command):
            assert set(extras.split(",")) <= set(project["optional-dependencies"]), f"{page}: {command}"
        words = command.split()
        if words[0] == "make":
            assert {word for word in words[1:] if "=" not in word} <= set(targets), f"{page}: {command}"
        if words[0].endswith("python") and words[1].endswith(".py"):
            assert (root / words[1]).is_file(), f"{page}: {command}"
