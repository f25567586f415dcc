"""What is told of a run: lines where there is no terminal, events for machines, nothing when it is quiet."""

import io
import json
import logging
from datetime import datetime
from pathlib import Path

import pytest
from click.testing import CliRunner
from rich.console import Console
from small_surveys import write_survey

from bumpymap.cli import _progress, main
from bumpymap.cli._exit_code import exit_code_of
from bumpymap.core.errors import BadInputError

ROOT = Path(__file__).resolve().parents[2]
QUARRY = ROOT / "sample_data" / "quarry.laz"


class Clock:
    """A clock that a test turns."""

    now = 1000.0

    def __call__(self):
        return self.now


def test_a_line_has_time_stage_and_share(capsys):
    clock = Clock()
    progress = _progress.TickedProgress(clock)
    progress.tick()
    assert capsys.readouterr().err == ""
    progress.start("reading points", 10_000_000)
    progress.advance(4_000_000)
    progress.advance(500_000)
    clock.now += 90.7
    progress.tick()
    progress.start("looking about\x1b", None)
    progress.advance(7)
    clock.now += 3600
    progress.tick()
    for done in (0, 12, 40):
        progress.compiling(done, 40)
    progress.compiling(39, 40)
    progress.tick()
    assert capsys.readouterr().err.splitlines() == [
        "0:01:30 reading points: 45% (4,500,000 of 10,000,000)",
        "1:01:30 looking about\\x1b: 7",
        "1:01:30 compiling, once: 0 of 40 kernels",
        "1:01:30 compiling, once: 40 of 40 kernels",
        "1:01:30 compiling, once: 39 of 40 kernels",
    ]


def test_a_bar_shows_a_name_as_it_is():
    shown = io.StringIO()
    with _progress.moving_bars(Console(file=shown, force_terminal=True, width=120)) as bars:
        bars.start("reading [red]a[/red]\x1b]0;owned\x07\nError: b.laz", 3)
        bars.advance(3)
        bars.compiling(12, 40)
    assert "12/40" in shown.getvalue()
    assert "reading [red]a[/red]\\x1b]0;owned\\x07\\nError: b.laz" in shown.getvalue()


def events(text):
    found = [json.loads(line) for line in text.splitlines()]
    times = [datetime.fromisoformat(event.pop("time")) for event in found]
    assert all(time.utcoffset().total_seconds() == 0 for time in times)
    assert times == sorted(times)
    return found


def test_events_hold_the_same(capsys):
    clock = Clock()
    progress = _progress.TickedProgress(clock, as_json=True)
    progress.start("reading points", 1000)
    progress.advance(250)
    clock.now += 12.34
    progress.tick()
    progress.start("timing", None)
    progress.tick()
    progress.note("text", "epoch", epoch=1, loss=0.5)
    progress.compiling(0, 40)
    assert events(capsys.readouterr().err) == [
        {"event": "stage", "stage": "reading points", "total": 1000},
        {"event": "progress", "stage": "reading points", "done": 250, "total": 1000, "share": 0.25, "seconds": 12.3},
        {"event": "stage", "stage": "timing", "total": None},
        {"event": "progress", "stage": "timing", "done": 0, "total": None, "share": None, "seconds": 12.3},
        {"event": "epoch", "epoch": 1, "loss": 0.5},
        {"event": "compiling", "done": 0, "total": 40},
    ]


def test_quiet_says_nothing(capsys):
    for as_json in (False, True):
        with _progress.show_progress(quiet=True, as_json=as_json) as progress:
            progress.start("reading", 10)
            progress.advance(1)
            progress.note("text", "epoch")
    assert capsys.readouterr() == ("", "")


def run(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def test_a_run_in_events(tmp_path):
    survey = write_survey(tmp_path / "a.laz")
    result = run("map", survey, "--out", tmp_path / "o", "--json")
    assert result.exit_code == 0
    found = events(result.stderr)
    assert [event["event"] for event in found if event["event"] not in {"info", "compiling"}] == [
        "start",
        "stage",
        "stage",
        "stage",
        "stage",
        "done",
    ]
    assert found[0]["arguments"] == ["map", str(survey), "--out", str(tmp_path / "o"), "--json"]
    assert found[-1]["exit_code"] == 0
    assert json.loads(result.stdout)["points"] == 20_000


@pytest.mark.parametrize(
    ("words", "code", "kind"),
    [
        (["map", "--none", "--json"], 2, "NoSuchOption"),
        (["map", "a.laz", "--json"], 2, "UsageError"),
        (["map", "a\x1b\n.laz", "--out", "o", "--json"], 3, "BadInputError"),
        (["info", "a.laz", "--json"], 3, "BadInputError"),
        (["train", "textures", "--json"], 2, "MissingParameter"),
        (["calibrate", "--json"], 2, "MissingParameter"),
        (["nothing", "--json"], 2, "NoSuchCommand"),
    ],
)
def test_the_last_event_of_a_failure(tmp_path, monkeypatch, words, code, kind):
    monkeypatch.chdir(tmp_path)
    result = run(*words)
    assert result.exit_code == code
    *_, last = events(result.stderr)
    assert (last["event"], last["exit_code"]) == ("error", code)
    assert last["message"]
    assert last["kind"] == kind or kind.startswith("NoSuch")  # older click has one name for these


def test_what_stands_after_two_dashes_is_no_option(tmp_path, capsys):
    def fail():
        raise BadInputError("no")

    assert exit_code_of(fail, ["map", "--", "--json"]) == 3
    assert capsys.readouterr().err == "Error: no\n"


def test_a_fault_is_an_event_with_its_traceback(capsys):
    def fail():
        raise KeyError("x")

    with pytest.raises(KeyError):
        exit_code_of(fail, ["map"])
    assert exit_code_of(fail, ["map", "--json"]) == 1
    last = events(capsys.readouterr().err)[-1]
    assert (last["event"], last["kind"]) == ("error", "KeyError")
    assert "Traceback" in last["traceback"]


def test_a_command_leaves_the_log_of_its_caller_alone(tmp_path):
    log = logging.getLogger("bumpymap")
    before = list(log.handlers), log.level, log.propagate
    for words in (["info", tmp_path / "none.laz"], ["map", "a.laz", "--json"], ["info", QUARRY, "--quick"]):
        run(*words)
        assert (list(log.handlers), log.level, log.propagate) == before
