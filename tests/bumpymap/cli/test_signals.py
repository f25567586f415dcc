"""What a run does when it is told to end: as a batch system does, and as a user does."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

QUARRY = Path(__file__).resolve().parents[3] / "sample_data" / "quarry.laz"

# The signal arrives at a known place: with early tiles finished, or with none.
WITH_TILES = """
import os, signal, sys
from bumpymap.cli import main
from bumpymap.engine.local import LocalRun
from bumpymap.engine.sink import TileSink

if {after_tiles}:
    flush = TileSink.flush
    def ending(sink):
        flush(sink)
        os.kill(os.getpid(), signal.{name})
    TileSink.flush = ending
else:
    def ending(*_, **__):
        os.kill(os.getpid(), signal.{name})
    LocalRun._decide = ending
sys.argv[0] = "bumpymap"
main()
"""


def ended(name, out, *, after_tiles):
    code = WITH_TILES.format(name=name, after_tiles=after_tiles)
    command = [sys.executable, "-c", code, "map", str(QUARRY), "--out", str(out), "--scratch", str(out.parent / "tmp")]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.parametrize(("name", "code", "word"), [("SIGTERM", 143, "Terminated."), ("SIGINT", 130, "Interrupted.")])
def test_a_signal_ends_a_run_clean_and_keeps_finished_tiles(tmp_path, name, code, word):
    out = tmp_path / "layers"
    early = ended(name, out, after_tiles=False)
    assert early.returncode == code, early.stderr
    assert early.stderr.strip() == f"{word} No file is half-written."
    assert not out.exists()
    assert list((tmp_path / "tmp").iterdir()) == []

    late = ended(name, out, after_tiles=True)
    assert late.returncode == code, late.stderr
    assert late.stderr.strip() == (
        f"{word} No file is half-written. Pass --resume to the same command to go on from the finished tiles."
    )
    assert [path.name for path in out.iterdir()] == [".bumpymap-run"]
    assert list((tmp_path / "tmp").iterdir()) == []
    again = [sys.executable, "-c", "from bumpymap.cli import main; main()", "map", str(QUARRY), "--out", str(out)]
    done = subprocess.run([*again, "--resume"], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert not (out / ".bumpymap-run").exists()


def test_a_caller_keeps_its_own_say_about_signals(tmp_path):
    from click.testing import CliRunner

    from bumpymap.cli import main

    def own(*_):
        raise AssertionError

    before = signal.signal(signal.SIGTERM, own)
    try:
        assert CliRunner().invoke(main, ["info", str(tmp_path)]).exit_code == 3
        assert signal.getsignal(signal.SIGTERM) is own
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        assert CliRunner().invoke(main, ["info", str(tmp_path)]).exit_code == 3
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGTERM, before)
