"""Events for machines, and foreign text, which is shown and never obeyed."""

import io
import json
import logging
import sys
import unicodedata
from datetime import datetime
from pathlib import Path

import pytest
from rich.console import Console
from small_surveys import run, write_survey

from bumpymap.cli import _output, exit_code_of
from bumpymap.cli._output import print_error, print_json, print_line, print_table
from bumpymap.core import BadInputError, escape_controls

ROOT = Path(__file__).resolve().parents[2]
QUARRY = ROOT / "sample_data" / "quarry.laz"


def events(text):
    found = [json.loads(line) for line in text.splitlines()]
    times = [datetime.fromisoformat(event.pop("time")) for event in found]
    assert all(time.utcoffset().total_seconds() == 0 for time in times)
    assert times == sorted(times)
    return found


def test_events_hold_the_same(capsys):
    now = [1000.0]
    progress = _output.TickedProgress(lambda: now[0], as_json=True)
    progress.start("reading points", 1000)
    progress.advance(250)
    now[0] += 12.34
    progress.tick()
    progress.start("timing", None)
    progress.tick()
    progress.note("text", "epoch", epoch=1, loss=0.5)
    assert events(capsys.readouterr().err) == [
        {"event": "stage", "stage": "reading points", "total": 1000},
        {"event": "progress", "stage": "reading points", "done": 250, "total": 1000, "share": 0.25, "seconds": 12.3},
        {"event": "stage", "stage": "timing", "total": None},
        {"event": "progress", "stage": "timing", "done": 0, "total": None, "share": None, "seconds": 12.3},
        {"event": "epoch", "epoch": 1, "loss": 0.5},
    ]


def test_a_run_in_events(tmp_path):
    survey = write_survey(tmp_path / "a.laz")
    result = run("map", survey, "--out", tmp_path / "o", "--json", code=0)
    found = events(result.stderr)
    kinds = [event["event"] for event in found if event["event"] != "info"]
    assert kinds == ["start", *4 * ["stage"], "done"]
    assert found[0]["arguments"] == ["map", str(survey), "--out", str(tmp_path / "o"), "--json"]
    assert found[-1]["exit_code"] == 0
    assert json.loads(result.stdout)["points"] == 20_000


@pytest.mark.parametrize(
    ("words", "code", "kind"),
    [
        (["map", "--none", "--json"], 2, "NoSuchOption"),
        (["map", "a.laz", "--json"], 2, "UsageError"),
        (["map", "a\x1b\n.laz", "--out", "o", "--json"], 3, "BadInputError"),
        (["nothing", "--json"], 2, "NoSuchCommand"),
    ],
)
def test_the_last_event_of_a_failure(tmp_path, monkeypatch, words, code, kind):
    monkeypatch.chdir(tmp_path)
    *_, last = events(run(*words, code=code).stderr)
    assert (last["event"], last["exit_code"]) == ("error", code)
    assert last["message"]
    assert last["kind"] == kind or kind.startswith("NoSuch")  # older click has one name for these


def test_what_stands_after_two_dashes_is_no_option_and_a_fault_is_an_event_with_its_traceback(capsys):
    def fail(error):
        raise error

    assert exit_code_of(lambda: fail(BadInputError("no")), ["map", "--", "--json"]) == 3
    assert capsys.readouterr().err == "Error: no\n"
    with pytest.raises(KeyError):
        exit_code_of(lambda: fail(KeyError("x")), ["map"])
    assert exit_code_of(lambda: fail(KeyError("x")), ["map", "--json"]) == 1
    last = events(capsys.readouterr().err)[-1]
    assert (last["event"], last["kind"], "Traceback" in last["traceback"]) == ("error", "KeyError", True)


def test_a_command_leaves_the_log_of_its_caller_alone(tmp_path):
    log = logging.getLogger("bumpymap")
    before = list(log.handlers), log.level, log.propagate
    for words in (["info", tmp_path / "none.laz"], ["map", "a.laz", "--json"], ["info", QUARRY, "--quick"]):
        run(*words)
        assert (list(log.handlers), log.level, log.propagate) == before


# --- foreign text ---
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
    with _output.moving_bars(Console(file=(bar := io.StringIO()), force_terminal=True, width=400)) as bars:
        bars.start(WICKED, 3)
        bars.advance(2)
    assert "2/3" in bar.getvalue()
    assert escape_controls(WICKED) in bar.getvalue()
    assert nothing_acts(out)
    assert nothing_acts(err)
    assert out.splitlines()[0] == err.rstrip("\n") == escape_controls(WICKED)
    assert "[red]d[/red] :smile:" in err
    assert json.loads(out.splitlines()[-1])["name"] == WICKED


def test_an_encoding_without_the_letters(monkeypatch):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, "ascii"))
    print_line("é 道")
    assert raw.getvalue() == b"\\xe9 \\u9053\n"


def test_lines_of_a_message_stay_lines(tmp_path):
    for name in ("a.laz", "b\nError: forged.laz"):
        (tmp_path / name).write_bytes(b"LASFnothing")
    result = run("map", tmp_path, "--out", tmp_path / "o", "--skip-bad", code=3)
    assert "forged" in result.stderr
    assert not any(line.startswith("Error: forged") for line in result.stderr.splitlines())
    found = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    assert found == ["Error: none of the inputs could be read:"]
