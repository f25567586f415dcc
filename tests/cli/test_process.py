"""A command as a process: signals, its end, pipes, little memory, full disks, no home, planted modules."""

import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from itertools import chain
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from cost_maps import make_field
from made_drives import churned_field, write_bin
from packaging.requirements import Requirement
from route_maps import write_folder
from small_surveys import run, write_survey

from bumpymap.cli import exit_code_of, main
from bumpymap.core.errors import OutputError, missing_resource
from bumpytiles import Grid

ROOT = Path(__file__).resolve().parents[2]
QUARRY = ROOT / "sample_data" / "quarry.laz"
COMMAND = [sys.executable, "-c", "from bumpymap.cli import main; main()"]
linux = pytest.mark.skipif(sys.platform != "linux", reason="limits are those of Linux")


def call(words, **options):
    options = {"capture_output": True, "text": True, "timeout": 300} | options
    return subprocess.run([str(word) for word in words], check=False, **options)


# --- the end of the process ---
PROGRAM = """
import atexit, sys
atexit.register(lambda: print("registered", end=""))
from bumpymap.__main__ import run
sys.argv = ["bumpymap", *sys.argv[1:]]
"""
KEPT_UNTIL_THE_END = "class Kept:\n def __del__(self): print('apart')\nkept = Kept()\n"


@pytest.mark.parametrize(("words", "code"), [(("--help",), 0), (("map", "--nothing"), 2)])
def test_functions_for_the_end_run_output_is_flushed_and_the_interpreter_is_not_taken_apart(words, code):
    done = call([sys.executable, "-c", f"{PROGRAM}{KEPT_UNTIL_THE_END}run()\n", *words])
    assert done.returncode == code
    assert done.stdout.endswith("registered")
    assert "Usage:" in done.stdout + done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.later
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("words", [["--help"], ["map", "--help"], ["--version"], ["info", QUARRY]])
def test_a_full_output_is_one_message(words):
    with Path("/dev/full").open("w") as full:
        done = call([*COMMAND, *words], capture_output=False, stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 3
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("Error: ")
    assert "No space left on device" in done.stderr


@pytest.mark.later
@pytest.mark.parametrize("words", [["--help"], ["info", QUARRY]])
def test_a_reader_that_leaves_is_no_error(words):
    reading, writing = os.pipe()
    os.close(reading)
    done = call([*COMMAND, *words], capture_output=False, stdout=writing, stderr=subprocess.PIPE)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")


# --- pipes instead of files: nothing waits for what nobody writes ---
class WaitedError(BaseException):
    """Nothing but the test may catch it."""


def wait(*_):
    raise WaitedError


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """A survey, a frame and a map."""
    folder = tmp_path_factory.mktemp("given")
    write_survey(folder / "survey.las", points=100)
    np.zeros((50, 4), np.float32).tofile(folder / "frame.bin")
    write_folder(folder / "layers", make_field(12, 10, grid=Grid(3.0, 5), easy=True))
    return folder


@pytest.mark.parametrize(
    "line",
    [
        *(
            f"map survey.las --out out {option}"
            for option in ("--set model=p.onnx", "--config p.toml", "--vehicle p.toml")
        ),
        *(f"{command} --out out --calibration p.json" for command in ("map survey.las", "scan frame.bin")),
        *("batch p.csv --out out", "batch p.txt --out out", "batch . --out out --config p.toml"),
        *(f"scan frame.bin --out out {option}" for option in ("--set model=p.onnx", "--poses p.txt")),
        *("scan p.mcap --out out", "scan p.db3 --out out"),
        *(f"route layers --points p{suffix}" for suffix in (".csv", ".gpx", ".geojson")),
        "route layers --from 1,1 --to 2,2 --avoid p.geojson",
        *(f"check --drive p{suffix}" for suffix in (".csv", ".ulg", ".bag", ".mcap")),
        "check layers --drive survey.las --refit new.json --calibration p.json",
        *("export layers --to plan --out out --route p.geojson", "report layers --out out.html --route p.geojson"),
        *("report piped --out out.html", "info p.las", "calibrate --vehicle p.toml --out out.json"),
    ],
)
def test_a_pipe_is_refused_and_not_waited_for(given, tmp_path, monkeypatch, line):
    monkeypatch.chdir(copytree(given, tmp_path / "here"))
    Path("piped").mkdir()
    name = next((word for word in re.split("[ =]", line) if word.startswith("p.")), "piped/run.json")
    os.mkfifo(name)
    before = signal.signal(signal.SIGALRM, wait)
    signal.alarm(20)
    try:
        done = run(*line.split())
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert done.exit_code in {2, 3}, done.output
    assert Path(name).name in done.output


# --- machines that give little: one message, exit code 3, never a traceback, never "the file is damaged" ---
def commands(folder):
    """Words of a command that looks, one that maps and one that classes a scan, by name."""
    write_bin(folder / "scan.bin", churned_field(1))
    return {
        "info": ["info", QUARRY],
        "map": ["map", QUARRY, "--out", folder / "layers"],
        "scan": ["scan", folder / "scan.bin", "--out", folder / "scanned"],
        "batch": ["batch", QUARRY.parent, "--out", folder / "night", "--jobs", "1"],
    }


def own_lines(text):
    """Lines of a command about its work, without how far a slow machine is.

    ONNX Runtime warns on its own where it cannot look at the devices of the machine.
    """
    aside = r"\d+:\d\d:\d\d |.*onnxruntime"
    return [line for line in text.splitlines() if not re.match(aside, line)]


@pytest.mark.later
@linux
@pytest.mark.parametrize("command", ["info", "map", "scan"])
@pytest.mark.parametrize("kilobytes", [200_000, 400_000])
def test_little_memory(tmp_path, command, kilobytes):
    limit = ["sh", "-c", f'ulimit -v {kilobytes} && unset OPENBLAS_NUM_THREADS && exec "$@"', "sh"]
    done = call([*limit, *COMMAND, *commands(tmp_path)[command]])
    assert "Traceback" not in done.stderr
    assert "damaged" not in done.stderr + done.stdout
    if done.returncode:
        assert (done.returncode, [line[:7] for line in own_lines(done.stderr)]) == (3, ["Error: "])
        assert "no memory left" in done.stderr or "no thread left" in done.stderr
        assert not (tmp_path / "layers" / "run.json").exists()


@pytest.mark.namespaces
@pytest.mark.parametrize("command", ["info", "map", "scan"])
def test_no_shared_memory(tmp_path, command):
    mount = ["unshare", "-m", "sh", "-c", 'mount -t tmpfs -o size=4k tmpfs /dev/shm && exec "$@"', "sh"]
    done = call([*mount, *COMMAND, *commands(tmp_path)[command]])
    assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr


@pytest.mark.later
@linux
@pytest.mark.parametrize("command", ["info", "map", "scan", "batch"])
def test_a_limit_on_the_size_of_files_is_no_damage_and_no_full_disk(tmp_path, command):
    done = call(["sh", "-c", 'ulimit -f 1 && exec "$@"', "sh", *COMMAND, *commands(tmp_path)[command]])
    assert done.returncode == 3
    first = done.stderr.splitlines()[0]
    assert "ulimit -f" in first
    assert "damaged" not in first
    assert "Free some space" not in first


def chained(outer, inner):
    outer.__cause__ = inner
    return outer


@pytest.mark.parametrize(
    ("error", "what"),
    [
        (MemoryError(), "memory"),
        (RuntimeError("can't start new thread"), "thread"),
        (OSError(errno.EMFILE, "Too many open files"), "file that may be opened"),
        (BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"), "process"),
        (ImportError("libx.so: failed to map segment from shared object"), "memory"),
        (chained(OutputError("cannot write"), OSError(errno.ENOMEM, "Cannot allocate memory")), "memory"),
        (chained(OutputError("cannot write"), OSError(errno.ENOSPC, "No space left on device")), ""),
        (OSError(errno.EFBIG, "File too large"), ""),
        (RuntimeError("anything"), ""),
    ],
)
def test_what_a_machine_lacks_is_told_from_what_a_file_lacks(error, what, capsys):
    assert missing_resource(error) == what

    def fail():
        raise error

    if type(error) is RuntimeError and not what:
        with pytest.raises(RuntimeError):
            exit_code_of(fail, [])
        return
    assert exit_code_of(fail, []) == 3
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert (f"the machine has no {what} left" in said[0]) == bool(what)


# --- a container's user: a number that no table of users knows, and no HOME ---
NOBODY = """
import os, pwd, sys
def nobody(_):
    raise KeyError("uid not found")
pwd.getpwuid = pwd.getpwnam = nobody
for name in ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "USER", "LOGNAME"):
    os.environ.pop(name, None)
from bumpymap.cli import main
main()
"""


@pytest.mark.later
@pytest.mark.parametrize("command", ["info", "map", "scan"])
def test_commands_need_no_home(tmp_path, command):
    done = call([sys.executable, "-c", NOBODY, *commands(tmp_path)[command]])
    assert (done.returncode, own_lines(done.stderr)) == (0, [])
    assert {"info": "1,250,148", "map": "Layers in", "scan": "Output in"}[command] in done.stdout


# --- modules in the current folder, or beside the surveys, are files of strangers: no command runs one ---
COMMANDS = {
    "map": "map surveys/a.laz --out new",
    "map with a filter in a child": "map surveys/a.laz --out new --ground csf",
    "batch": "batch surveys --out new --jobs 2",
    "demo": "demo --out new",
    "info": "info surveys/a.laz",
    "route": "route layers --from 500005,4000006 --to 500011,4000012 --out way --set cost.robust=true",
    "diff": "diff layers layers --out new",
    "report": "report layers --overwrite",
    "export": "export layers --to nav2 --out new",
    "check": "check layers --drive surveys/drive.csv --out new",
    "scan": "scan surveys/frame.bin --out new",
    "vehicle": "vehicle list",
    "view": "view layers --out new.tif",
    "settings": "settings map",
    "calibrate": "calibrate --out layers",
    "evaluate": "evaluate scans surveys/frame.bin --out new",
    "train": "train scans surveys --out n.onnx",
}
FAIL = {"calibrate": 2, "check": 3, "evaluate": 3, "scan": 3, "train": 3, "view": 2}
"""Commands that have no fit input here, and end once they have imported what they need."""
PLANTED = """
import operator
import bumpymap
from bumpymap.lab.simulate.jobs import run_in_processes
if __name__ == "__main__":
    assert sorted(run_in_processes(operator.neg, [1, 2], 2)) == [(0, -1), (1, -2)]
    bumpymap.map_survey("surveys/a.laz", "new", overwrite=True)
"""


@pytest.fixture(scope="module", name="place")
def place_fixture(tmp_path_factory):
    """A current folder and one of surveys, in which every module that a command may want is planted."""
    place = tmp_path_factory.mktemp("planted") / "here"
    for name in "ab":
        write_survey(place / "surveys" / f"{name}.laz", points=5000, side=12.0)
    (place / "surveys" / "drive.csv").write_text("time\n")
    (place / "surveys" / "frame.bin").write_bytes(b"")
    (place.parent / "bin").mkdir()
    (place.parent / "bin" / "bumpymap").write_text("from bumpymap.__main__ import run\nrun()\n")
    (place.parent / "bin" / "program").write_text(PLANTED)
    assert planted_ends(place, [str(place.parent / "bin" / "bumpymap"), "map", "surveys/a.laz", "--out", "layers"]) == 0
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = chain(project["dependencies"], *project["optional-dependencies"].values())
    names = {Requirement(line).name.replace("-", "_") for line in needed} | {"PIL", "CSF", "skimage", "sklearn", "dask"}
    plant(place, {*sys.stdlib_module_names, *names, "bumpymap", "bumpytiles", "sitecustomize", "usercustomize"})
    return place


def plant(place, names):
    for folder in (place, place / "surveys"):
        for name in names:
            code = f"open({str(place.parent / 'ran')!r}, 'a').write(__file__ + '\\n')\nraise ImportError('planted')\n"
            (folder / f"{name}.py").write_text(code, encoding="utf-8")


def planted_ends(place, arguments):
    done = call([sys.executable, *arguments], cwd=place)
    assert not (place.parent / "ran").exists(), (place.parent / "ran").read_text()
    assert "Traceback" not in done.stderr, done.stderr
    return done.returncode


def test_all_commands_are_tried():
    assert set(main.list_commands(None)) == {words.split()[0] for words in COMMANDS.values()}


@pytest.mark.later
@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_runs_a_module_of_the_current_folder(place, command):
    shutil.rmtree(place / "new", ignore_errors=True)
    code = planted_ends(place, [str(place.parent / "bin" / "bumpymap"), *COMMANDS[command].split()])
    assert code == FAIL.get(command, 0)


@pytest.mark.later
def test_no_process_of_a_program_runs_one(place):
    assert planted_ends(place, [str(place.parent / "bin" / "program")]) == 0


@pytest.mark.later
def test_python_m_runs_none_once_it_has_found_the_package(tmp_path):
    write_survey(tmp_path / "here" / "surveys" / "a.laz", points=5000, side=12.0)
    plant(tmp_path / "here", ["numpy", "click", "json", "multiprocessing", "bumpytiles", "rasterio", "distributed"])
    assert planted_ends(tmp_path / "here", ["-m", "bumpymap", *COMMANDS["map with a filter in a child"].split()]) == 0


# ---- what a run does when it is told to end: as a batch system does, and as a user does ----


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
@pytest.mark.parametrize(
    ("name", "code", "word"),
    [("SIGTERM", 143, "Terminated."), pytest.param("SIGINT", 130, "Interrupted.", marks=pytest.mark.later)],
)
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
