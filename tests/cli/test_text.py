"""What leaves for the terminal: foreign text is shown, never obeyed, and a lost output is one message."""

import ast
import io
import json
import os
import subprocess
import sys
import unicodedata
from pathlib import Path

import pytest
from click.testing import CliRunner

from bumpymap.cli import main
from bumpymap.cli._text import print_error, print_json, print_line, print_table
from bumpymap.core import escape_controls

ROOT = Path(__file__).resolve().parents[2]
QUARRY = ROOT / "sample_data" / "quarry.laz"
WICKED = (
    "a\x1b[31m\x1b]0;owned\x07 b\nError: c\r\t\x7f\x9b \u202egnp \u2066 \u2028 \u200f \udcff [red]d[/red] :smile: é 道"
)


def nothing_acts(text):
    """Whether every line holds nothing that a terminal acts on."""
    return all(unicodedata.category(letter) not in {"Cc", "Cf", "Cs", "Zl", "Zp"} for letter in text.replace("\n", ""))


def test_no_letter_acts():
    for letter in map(chr, [*range(0x3000), *range(0xD800, 0xE000), *range(0xE0000, 0xE0100)]):
        shown = escape_controls(f"a{letter}b")
        assert (shown[0], shown[-1]) == ("a", "b")
        assert nothing_acts(shown) and "\n" not in shown, hex(ord(letter))  # noqa: PT018 (many times)


def test_every_way_out_shows_it(capsys):
    print_line(WICKED, "bold")
    print_table([(WICKED, WICKED)])
    print_table([(WICKED, WICKED)], ["one", "two"])
    print_json({"name": WICKED})
    print_error(WICKED)
    out, err = capsys.readouterr()
    assert nothing_acts(out)
    assert nothing_acts(err)
    assert out.splitlines()[0] == err.rstrip("\n") == escape_controls(WICKED)
    assert "[red]d[/red] :smile:" in err
    assert json.loads(out.splitlines()[-1])["name"] == WICKED


def test_a_line_of_a_table_ends_with_its_last_value(capsys):
    print_table([("smooth", "2", "0.04"), ("all the others", "13", "")], ["class", "tiles", "c_r"])
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["class           tiles   c_r", "smooth              2  0.04", "all the others     13"]


def test_an_encoding_without_the_letters(monkeypatch):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, "ascii"))
    print_line("é 道")
    assert raw.getvalue() == b"\\xe9 \\u9053\n"


def test_no_command_has_a_way_out_of_its_own():
    """Text goes through `_text` (and bars through rich, with names made safe)."""
    for file in (ROOT / "bumpymap" / "cli").glob("*.py"):
        if file.name == "_text.py":
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                name = ast.unparse(node.func)
                assert name not in {"print", "click.echo", "click.secho", "Console"}, f"{file.name}: {name}"
            if isinstance(node, ast.Attribute):
                assert ast.unparse(node) not in {"sys.stdout", "sys.stderr"}, f"{file.name}: {ast.unparse(node)}"


def run(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.fixture
def wicked(tmp_path):
    """A survey whose name a terminal would obey."""
    path = tmp_path / f"{WICKED.replace('/', '|')}.laz"
    try:
        path.symlink_to(QUARRY)
    except OSError:
        pytest.skip("the file system refuses such names")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("command", ["info", "map", "scan", "evaluate", "train"])
def test_names_of_files_are_shown(command, wicked, tmp_path):
    words = {
        "info": [wicked],
        "map": [
            wicked.rename(tmp_path / "a\x1b[31m[red]\nError: b.laz"),
            "--out",
            tmp_path / "\x1b]\nError: d",
            "--local",
        ],
        "scan": [wicked, "--out", tmp_path / "o"],
        "evaluate": [wicked, "--out", tmp_path / "o"],
        "train": ["--out", wicked],
    }[command]
    named = {"evaluate": ["evaluate", "survey"], "train": ["train", "textures"]}
    result = run(*named.get(command, [command]), *words)
    said = result.stdout + result.stderr
    assert not isinstance(result.exception, UnicodeError)
    assert nothing_acts(said), said
    if command in {"info", "scan"}:
        assert "\\x1b[31m" in said
        assert "\\xff" in said
    elif command == "map":
        assert "\\x1b]\\nError: d" in result.stdout


def test_lines_of_a_message_stay_lines(tmp_path):
    for name in ("a.laz", "b\nError: forged.laz"):
        (tmp_path / name).write_bytes(b"LASFnothing")
    result = run("map", tmp_path, "--out", tmp_path / "o", "--skip-bad")
    assert result.exit_code == 3
    assert "forged" in result.stderr
    assert not any(line.startswith("Error: forged") for line in result.stderr.splitlines())
    found = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    assert found == ["Error: none of the inputs could be read:"]


COMMAND = [sys.executable, "-c", "from bumpymap.cli import main; main()"]


def piped(words, **streams):
    return subprocess.run([*COMMAND, *map(str, words)], text=True, timeout=300, check=False, **streams)


needs_full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")


@pytest.mark.later
@needs_full
@pytest.mark.parametrize("words", [["--help"], ["map", "--help"], ["--version"], ["info", QUARRY]])
def test_a_full_output_is_one_message(words):
    with Path("/dev/full").open("w") as full:
        done = piped(words, stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 3
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("Error: ")
    assert "No space left on device" in done.stderr


@pytest.mark.later
@pytest.mark.parametrize("words", [["--help"], ["info", QUARRY]])
def test_a_reader_that_leaves_is_no_error(words):
    reading, writing = os.pipe()
    os.close(reading)
    done = piped(words, stdout=writing, stderr=subprocess.PIPE)
    os.close(writing)
    assert done.returncode == 141
    assert done.stderr == ""
