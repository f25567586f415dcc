"""What a run does when it is told to end: as a batch system does, and as a user does."""

import os
import signal
import subprocess
import sys
import time

import pytest
from small_surveys import run, write_survey

# The signal arrives at a known place: with early tiles finished, or with none.


WITH_TILES = """
import os, signal, sys
from bumpymap.cli import main
from bumpymap.survey.engine import run

if {after_tiles}:
    add_tiles = run.ResultCollector.add_tiles
    def ending(*arguments):
        add_tiles(*arguments)
        os.kill(os.getpid(), signal.{name})
    run.ResultCollector.add_tiles = ending
else:
    def ending(*_, **__):
        os.kill(os.getpid(), signal.{name})
    run.decide_ground = ending
sys.argv[0] = "bumpymap"
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "code", "word"),
    [("SIGTERM", 143, "Terminated."), pytest.param("SIGINT", 130, "Interrupted.", marks=pytest.mark.later)],
)
def test_a_signal_ends_a_run_clean_and_keeps_finished_tiles(tmp_path, name, code, word):
    out, survey = tmp_path / "layers", write_survey(tmp_path / "site.laz")
    words = ["map", str(survey), "--out", str(out), "--set", f"scratch={tmp_path / 'tmp'}"]
    for after_tiles in (False, True):
        command = [sys.executable, "-c", WITH_TILES.format(name=name, after_tiles=after_tiles), *words]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == code, done.stderr
        more = " Run the same again to continue from the finished tiles." if after_tiles else ""
        assert done.stderr.strip() == f"{word} No file is half-written.{more}"
        assert [path.name for path in out.rglob("*") if path.parent == out] == [".bumpymap-run"] * after_tiles
        assert list((tmp_path / "tmp").iterdir()) == []
    run("map", survey, "--out", out, code=0)
    assert not (out / ".bumpymap-run").exists()


# Children of one process that has imported everything; each gets the signal at another call of its main thread.
AT_INSTANTS = """
import atexit, os, signal, sys
from pathlib import Path
import bumpymap.survey.pipeline
from bumpymap.cli import map_command
from bumpymap.__main__ import run

folder, survey = Path(sys.argv[1]), sys.argv[2]
seen = 0

def child(at):
    pid = os.fork()
    if pid:
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    said = os.open(folder / f"{at}.txt", os.O_WRONLY | os.O_CREAT)
    os.dup2(said, 1)
    os.dup2(said, 2)

    def tick(*_):
        global seen
        seen += 1
        if seen == at:
            os.kill(os.getpid(), signal.SIGTERM)

    if not at:
        atexit.register(lambda: (folder / "steps").write_text(str(seen)))
    out = ["--out", str(folder / f"out_{at}"), "--set", f"scratch={folder / 'tmp'}"]
    sys.argv = ["bumpymap", "map", survey, *out, "--quiet"]
    sys.setprofile(tick)
    run()

print(0, child(0), flush=True)
steps = int((folder / "steps").read_text())
for instant in range(1, INSTANTS):
    at = instant * steps // INSTANTS
    print(at, child(at), flush=True)
"""


INSTANTS = 12


@pytest.mark.later
def test_no_instant_gives_a_traceback(tmp_path):
    survey = write_survey(tmp_path / "small.las")
    code = AT_INSTANTS.replace("INSTANTS", str(INSTANTS))
    command = [sys.executable, "-c", code, str(tmp_path), str(survey)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    (_, whole), *ended = (tuple(map(int, line.split())) for line in done.stdout.splitlines())
    assert whole == 0
    assert len(ended) == INSTANTS - 1
    for at, code in ended:
        said = (tmp_path / f"{at}.txt").read_text()
        # A run that is over has nothing to say; the signal ends its process all the same.
        assert code == 143, said
        assert said.startswith("Terminated. No file is half-written."), said
        assert len(said.splitlines()) == 1, said
        out = tmp_path / f"out_{at}"
        left = {path.name for path in out.iterdir()} if out.exists() else set()
        assert left in (set(), {".bumpymap-run"}) or "run.json" in left
        assert not list((tmp_path / "tmp").glob("*")), "points were left"


# Drives that take for ever, all but the first; each says in whose process it is.
SLOW = """
import os, time
from pathlib import Path
from bumpymap.lab.simulate.drive import PatchDrives

def run_job(settings, job):
    if job.key == ("table", 0, 0, 0):
        return PatchDrives(("completed",) * job.starts, (0.1,) * job.starts)
    (Path(__file__).parent / f"{os.getpid()}.worker").touch()
    time.sleep(3600)
"""


DRIVING = """
import sys
sys.path.insert(0, {folder!r})
import slow
import bumpymap.lab.simulate.model
bumpymap.lab.simulate.model.require_dart = lambda: None
import bumpymap.lab.simulate.calibrate
bumpymap.lab.simulate.calibrate.run_job = slow.run_job
bumpymap.lab.simulate.calibrate.seconds_of_drives = lambda settings: 1.0
from bumpymap.cli import main
sys.argv[0] = "bumpymap"
main()
"""


KEPT = "No file is half-written. The driven patches are kept: give the same command again to continue."


@pytest.mark.slow
@pytest.mark.parametrize(("name", "code", "word"), [("SIGTERM", 143, "Terminated."), ("SIGINT", 130, "Interrupted.")])
@pytest.mark.parametrize("send", [pytest.param("kill", marks=pytest.mark.later), "killpg"])
def test_a_signal_ends_the_workers_too_and_keeps_what_was_driven(tmp_path, name, code, word, send):
    (tmp_path / "slow.py").write_text(SLOW)
    progress = tmp_path / "c.json.progress.jsonl"
    words = ["calibrate", "--vehicle", "warthog", "--out", str(tmp_path / "c.json"), "--jobs", "2"]
    calibrating = subprocess.Popen(
        [sys.executable, "-c", DRIVING.format(folder=str(tmp_path)), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        while len(list(tmp_path.glob("*.worker"))) < 2 or len(progress.read_text().splitlines()) < 2:
            assert calibrating.poll() is None, calibrating.communicate()[1]
            time.sleep(0.02)
        getattr(os, send)(calibrating.pid, getattr(signal, name))
        stderr = calibrating.communicate(timeout=60)[1]
    finally:
        calibrating.kill()
    assert calibrating.returncode == code, stderr
    assert stderr.strip() == f"{word} {KEPT}"
    assert len(progress.read_text().splitlines()) == 2
    assert not (tmp_path / "c.json").exists()
    for worker in tmp_path.glob("*.worker"):
        with pytest.raises(ProcessLookupError):
            os.kill(int(worker.stem), 0)


def test_a_caller_keeps_its_own_say_about_signals(tmp_path):
    def own(*_):
        raise AssertionError

    before = signal.signal(signal.SIGTERM, own)
    try:
        run("info", tmp_path, code=3)
        assert signal.getsignal(signal.SIGTERM) is own
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        run("info", tmp_path, code=3)
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGTERM, before)
