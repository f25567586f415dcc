"""The second engine: the same bits from workers as from one process, whatever happens to them; and its security."""

import json
import os
import random
import re
import shutil
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from small_surveys import killed_at, layers_of, run, write_las

import bumpytiles
from bumpymap.core import OutputError, UsageError, install_command
from bumpymap.readers import ReadOptions, hash_survey, identity
from bumpymap.survey.engine.block_work import BlockWork
from bumpymap.survey.engine.cluster import (
    ALIVE,
    RunContext,
    finish_group,
    mark_tiles,
    missing_on_worker,
    opened,
    read_ranges,
)
from bumpymap.survey.engine.reading import ChunkRange, ReadTask
from bumpytiles import ClusterError, Grid

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("without_views")]

ROOT = Path(__file__).resolve().parents[3]
SURVEY, PAGE = ROOT / "sample_data" / "quarry_part.ply", ROOT / "docs" / "pages" / "big-sites.md"
ONE_WORKER = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": ":0", "memory_limit": 0, "silence_logs": 50}
ALL_RANGES = 11
"""Ranges of the three surveys where a task reads 10,000 points at least."""
TWO_TASKS = 57_000
"""Least points of a task with which two tasks read the three surveys, one of them two files."""

DEADLY = '''
import os, signal
from pathlib import Path

class Deadly:
    """Kills its own process, once or always."""
    def __init__(self, work, mark, always):
        self.work, self.mark, self.always = work, mark, always
    def __call__(self, points, ground_only, *more):
        if self.always or not Path(self.mark).exists():
            Path(self.mark).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return self.work(points, ground_only, *more)
'''


def record_of(folder):
    return json.loads((folder / "run.json").read_text(encoding="utf-8"))


def inputs_of(folder):
    """Checksums and all else that is recorded of the inputs."""
    return record_of(folder)["inputs"]


def map_on(scheduler, surveys, out, *more, **how):
    return run("map", surveys, "--out", out, "--set", f"scheduler={scheduler}", *more, **how)


def write_part(path, columns, chosen, offset):
    *place, kind = (axis[chosen] for axis in columns)
    return write_las(path, *place, offset=offset, classification=kind)


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    """Three files of one site, 150 m x 60 m, that overlap: points in random order, some twice, some in a far corner.

    Boulders stand there, many across the edges of blocks.
    """
    rng = np.random.default_rng(3)
    n = 90_000
    x, y = rng.uniform(0.01, 149.99, n), rng.uniform(0.01, 59.99, n)
    z = 100 + 0.02 * x + np.where(x > 70, 0.25 * np.sin(9 * x) * np.sin(8 * y), 0.0) + 0.004 * rng.normal(size=n)
    for east, north in np.column_stack([48.0 * rng.integers(0, 4, 60) + rng.normal(0, 3, 60), rng.uniform(0, 60, 60)]):
        z += 0.8 * np.sqrt(np.maximum(0.0, 0.6 - (x + 1 - east) ** 2 - (y - north) ** 2))
    kind = np.where(rng.random(n) < 0.6, 2, 5).astype(np.uint8)
    columns = (np.round(x, 3) + 500_001, np.round(y, 3) + 4_000_002, np.round(z, 3), kind)
    folder = tmp_path_factory.mktemp("surveys")
    write_part(folder / "a.laz", columns, np.flatnonzero(x < 90), (500_000, 4_000_000, 0))
    write_part(folder / "b.las", columns, np.flatnonzero(x > 60)[::-1], (499_000.5, 3_999_000, 7))
    write_part(folder / "c.las", columns, rng.permutation(np.flatnonzero((x < 40) & (y < 25))), (500_100, 4_000_000, 0))
    return folder


@pytest.fixture(scope="module")
def plain(surveys, tmp_path_factory):
    """Layers that one process makes of them."""
    made = tmp_path_factory.mktemp("plain")
    for ground in ("auto", "all"):
        run("map", surveys, "--out", made / ground, "--ground", ground, code=0)
    return made


class Here:
    """Stands in for workers: does every task in this process, in random order, some of them twice."""

    def __init__(self, seed=0):
        self.random, self.done = random.Random(seed), []

    def count(self):
        return 3

    def each(self, function, *arguments):
        return {"here": function(*arguments)}

    def run(self, function, tasks):
        numbered = list(enumerate(tasks))
        self.random.shuffle(numbered)
        for number, task in numbered:
            if self.random.random() < 0.3:
                function(*task)
            self.done.append(function)
            yield number, function(*task)


@pytest.fixture
def here(monkeypatch, limit_points):
    """Workers that are none, small parts, and no room in memory."""
    workers = Here()

    @contextmanager
    def connect(scheduler):
        yield workers if scheduler else None

    monkeypatch.setattr("bumpymap.survey.pipeline.connect", connect)
    monkeypatch.setitem(vars(bumpytiles), "threads_here", lambda: 2)
    monkeypatch.setattr("bumpymap.survey.engine.reading.LEAST_POINTS", 10_000)
    monkeypatch.setattr("bumpymap.survey.engine.collector.MOST_BLOCKS", 3)
    limit_points(chunk=4_000, waiting=9_000, block=5_000)
    return workers


@pytest.mark.parametrize(
    ("ground", "least", "tasks"),
    [("auto", 10_000, ALL_RANGES), ("all", TWO_TASKS, 2), pytest.param("auto", 10**7, 1, marks=pytest.mark.later)],
)
def test_tasks_in_any_order_done_once_or_twice_give_the_same_bits(
    surveys, plain, tmp_path, here, ground, least, tasks, monkeypatch
):
    """A task reads a part of a file, or several files: then it has blocks that no other task reaches."""
    monkeypatch.setattr("bumpymap.survey.engine.reading.LEAST_POINTS", least)
    out = tmp_path / "layers"
    scratch = ("--set", "scheduler=here", "--set", f"scratch={tmp_path / 'scratch'}")
    run("map", surveys, "--out", out, "--ground", ground, *scratch, code=0)
    assert layers_of(out) == layers_of(plain / ground)
    assert list((tmp_path / "scratch").iterdir()) == []
    assert here.done.count(read_ranges) == tasks
    assert (mark_tiles in here.done) == (ground == "auto" and tasks > 1)
    assert record_of(out)["points"] == record_of(plain / ground)["points"]
    assert inputs_of(out) == inputs_of(plain / ground)
    assert [entry["checksum"] for entry in inputs_of(out)] == [hash_survey(path) for path in sorted(surveys.iterdir())]


def test_workers_find_the_part_that_was_never_classified(tmp_path, here, monkeypatch):
    rng = np.random.default_rng(6)
    x, y = rng.uniform(0.01, 119.99, 80_000), rng.uniform(0.01, 47.99, 80_000)
    columns = (x + 500_001, y + 4_000_002, 0.02 * x + 0.01 * rng.normal(size=len(x)), np.where(x < 61, 2, 1))
    for number, chosen in enumerate((np.flatnonzero(x < 80), np.flatnonzero(x > 50))):
        write_part(tmp_path / "site" / f"{number}.las", columns, chosen, (500_000, 4_000_000, 0))
    monkeypatch.setattr("bumpymap.survey.engine.reading.LEAST_POINTS", 10_000)
    records = []
    for name, extra in (("one", ()), ("many", ("--set", "scheduler=here"))):
        run("map", tmp_path / "site", "--out", tmp_path / name, *extra, code=0)
        records.append(record_of(tmp_path / name))
    assert records[0]["tiles_from_all_points"] == records[1]["tiles_from_all_points"] > 300
    assert here.done.count(finish_group) > 1
    assert layers_of(tmp_path / "many") == layers_of(tmp_path / "one")


@pytest.mark.parametrize(("ground", "least"), [("auto", 10_000), pytest.param("all", 10**7, marks=pytest.mark.later)])
def test_bad_files_are_skipped_with_the_same_words(surveys, tmp_path, here, monkeypatch, ground, least):
    """Those that share a task with good files too."""
    monkeypatch.setattr("bumpymap.survey.engine.reading.LEAST_POINTS", least)
    for file in surveys.iterdir():
        shutil.copy(file, tmp_path)
    cut = bytearray((surveys / "a.laz").read_bytes())
    middle = len(cut) // 2
    cut[middle : middle + 400] = bytes(400)
    (tmp_path / "broken.laz").write_bytes(cut)
    lying = bytearray((surveys / "c.las").read_bytes())
    lying[179:187] = np.float64(500_020).tobytes()  # max x: points lie outside, which the last of them may tell
    (tmp_path / "lying.las").write_bytes(lying)
    arguments = ("map", *sorted(tmp_path.glob("*.la?")), "--ground", ground)
    refused = run(*arguments, "--out", tmp_path / "refused", "--set", "scheduler=here", code=3)
    assert f"\n{refused.output}".count("\nError: ") == 1
    assert not (tmp_path / "refused").exists()
    for name, extra in (("one", ()), ("many", ("--set", "scheduler=here"))):
        run(*arguments, "--out", tmp_path / name, "--skip-bad", *extra, code=4)
    assert layers_of(tmp_path / "many") == layers_of(tmp_path / "one")
    records = [record_of(tmp_path / name) for name in ("one", "many")]
    assert len(records[0]["skipped"]) == 2
    assert records[0]["skipped"].keys() == records[1]["skipped"].keys()
    assert all(records[0][key] == records[1][key] for key in ("inputs", "points", "ground_only"))


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("ground", ["auto", pytest.param("all", marks=pytest.mark.later)])
def test_a_killed_run_goes_on_with_another_engine(surveys, plain, tmp_path, ground, monkeypatch):
    monkeypatch.setattr("bumpymap.survey.engine.reading.LEAST_POINTS", TWO_TASKS)
    one = surveys, "--ground", ground
    many = *one, "--set", "scheduler=here"
    for before, after, place in ((many, one, "ResultCollector.add_tiles"), (one, many, "decide_ground")):
        left = tmp_path / place
        killed_at(f"survey.engine.run.{place}", left, *before)
        run("map", *after, "--out", left, code=0)
        assert layers_of(left) == layers_of(plain / ground)
        assert inputs_of(left) == inputs_of(plain / ground)


def test_a_worker_that_does_not_fit_says_why(surveys, tmp_path):
    points, tiles = tmp_path / "points", tmp_path / "tiles"
    for made in (points, tiles):
        made.mkdir()
        (made / ALIVE).write_text("id")
    context = RunContext(BlockWork(Grid(), (), Mock(), "all"), 1 << 30, points, tiles, "id", ReadOptions(), 1000)
    versions = {"numpy": "2.0"}
    assert missing_on_worker(context, versions.copy, versions) is None
    assert "numpy 2.0, not 1.9" in missing_on_worker(context, versions.copy, {"numpy": "1.9"})
    file = surveys / "a.laz"
    known = identity(file)
    with pytest.raises(UsageError, match="differs from the file on the client"):
        opened(file, ReadOptions(), (known["size"], "0"), "id")
    with pytest.raises(UsageError, match="cannot open a file of the client"):
        opened(tmp_path / "none.laz", ReadOptions(), (known["size"], known["digest"]), "id")
    (context.tiles / ALIVE).unlink()
    assert "folders that every worker sees" in missing_on_worker(context, versions.copy, versions)
    task = ReadTask((ChunkRange(0, 0, 1, 1000, None, is_whole=False),), None)
    with pytest.raises(OutputError, match="folders that every worker sees"):
        read_ranges(context, [(file, (known["size"], known["digest"]))], task)


@pytest.fixture(scope="module")
def distributed():
    return pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def scheduler(distributed, tmp_path_factory):
    """Address of a real cluster of two processes, which gives a task up when it killed its second worker.

    Its workers and this process can import ``deadly_helpers``.
    """
    folder = tmp_path_factory.mktemp("helpers")
    (folder / "deadly_helpers.py").write_text(DEADLY)
    sys.path.insert(0, str(folder))
    paths, dask = {"PYTHONPATH": os.pathsep.join(sys.path)}, pytest.importorskip("dask")
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(**ONE_WORKER | {"n_workers": 2}, env=paths) as cluster,
    ):
        yield cluster.scheduler_address
    sys.path.remove(str(folder))


def make_deadly(monkeypatch, mark, *, always=False):
    """Have the work of runs kill the process that does it."""
    from deadly_helpers import Deadly

    def block_work(grid, columns, work, *more):
        return BlockWork(grid, columns, Deadly(work, str(mark), always), *more)

    monkeypatch.setattr("bumpymap.survey.pipeline.BlockWork", block_work)


@pytest.mark.later
def test_workers_filter_the_ground_as_this_process_does(surveys, tmp_path, scheduler):
    pytest.importorskip("CSF")
    run("map", surveys, "--out", tmp_path / "one", "--ground", "csf", code=0)
    map_on(scheduler, surveys, tmp_path / "many", "--ground", "csf", code=0)
    assert layers_of(tmp_path / "many") == layers_of(tmp_path / "one")


@pytest.mark.later
@pytest.mark.parametrize("least", [10_000, 10**7])
def test_a_worker_killed_in_the_middle_changes_no_bit(surveys, plain, tmp_path, scheduler, monkeypatch, least):
    """In one task, blocks are finished while the files are read; in parts, all of them later."""
    monkeypatch.setattr("bumpymap.survey.engine.reading.LEAST_POINTS", least)
    monkeypatch.setattr("bumpymap.survey.engine.budget.Budget.chunk_points", 5_000)
    mark = tmp_path / "killed"
    make_deadly(monkeypatch, mark)
    result = map_on(scheduler, surveys, tmp_path / "layers", "--ground", "all")
    assert (result.exit_code, mark.exists()) == (0, True), result.output
    assert layers_of(tmp_path / "layers") == layers_of(plain / "all")
    assert not (tmp_path / "layers" / ".bumpymap-run").exists()


@pytest.mark.later
def test_workers_that_die_over_and_over_end_the_run_with_a_word(surveys, tmp_path, scheduler, monkeypatch):
    make_deadly(monkeypatch, tmp_path / "killed", always=True)
    result = map_on(scheduler, surveys, tmp_path / "layers", code=2)
    assert "2 workers died one after the other over one task" in result.output
    assert "--memory" in result.output
    assert not (tmp_path / "layers").exists()


def io_loops():
    return sum(thread.name == "IO loop" for thread in threading.enumerate())


@pytest.mark.later
def test_a_scheduler_that_is_not_there_is_told_in_time(surveys, distributed, tmp_path, monkeypatch):
    monkeypatch.setattr("bumpymap.survey.engine.cluster._TIMEOUT_S", 0.5)
    for address in ("tcp://127.0.0.1:9", "no such place", "ftp://a:1"):
        before = io_loops()
        result = map_on(address, surveys, tmp_path / "layers", code=2)
        assert f"no scheduler answers at {address}" in result.output
        assert io_loops() == before  # the garbage collector would end it, and might wait for ever
    monkeypatch.setattr("bumpymap.survey.engine.cluster._TIMEOUT_S", 5.0)
    with distributed.LocalCluster(n_workers=0, dashboard_address=":0", silence_logs=50) as empty:
        assert "has no workers" in map_on(empty.scheduler_address, surveys, tmp_path / "layers").output
    assert not (tmp_path / "layers").exists()


@pytest.mark.later
def test_a_scheduler_that_goes_away_ends_the_run_with_a_word(surveys, distributed, tmp_path, monkeypatch):
    monkeypatch.setattr("bumpymap.survey.engine.reading.LEAST_POINTS", 10_000)
    monkeypatch.setattr("bumpymap.survey.engine.budget.Budget.chunk_points", 5_000)
    monkeypatch.setattr("bumpymap.survey.engine.cluster._TIMEOUT_S", 5.0)  # it is tried for so long to reach it again
    with distributed.LocalCluster(**ONE_WORKER) as cluster:
        once = iter([cluster.close])  # closing it again, while it closes, is an error of Dask's
        monkeypatch.setattr(
            "bumpymap.survey.engine.collector.ResultCollector.add", lambda *_: next(once, lambda: None)()
        )
        result = map_on(cluster.scheduler_address, surveys, tmp_path / "layers", code=2)
    assert "the connection to the scheduler is lost" in result.output
    assert not (tmp_path / "layers").exists()


@pytest.mark.parametrize("when", ["look", "read", pytest.param("finish", marks=pytest.mark.later)])
@pytest.mark.usefixtures("distributed")
def test_workers_that_are_lost_end_the_run_with_a_word_and_nothing_is_read_twice(
    surveys, plain, tmp_path, here, monkeypatch, when
):
    out, whole = tmp_path / "layers", here.run
    arguments = ("map", surveys, "--out", out, "--set", "scheduler=here", "--set", f"scratch={tmp_path / 'scratch'}")

    def lost(*_, **__):
        raise ClusterError("all 2 workers were lost")

    def lost_after_three(function, tasks):
        for number, result in whole(function, tasks):
            yield number, result
            if len(here.done) >= 3:
                lost()

    executor = "bumpymap.survey.engine.cluster.ClusterExecutor.finish"
    place = {"look": (here, "each", lost), "read": (here, "run", lost_after_three), "finish": (executor, lost)}[when]
    with monkeypatch.context() as patch:
        patch.setattr(*place)
        result = run(*arguments, code=2)
    assert "all 2 workers were lost. Look at their logs" in result.output
    assert "nstall" not in result.output
    if when == "look":
        assert not out.exists()
        return
    assert "Run the same again to continue" in result.output
    run(*arguments, code=0)
    assert here.done.count(read_ranges) == ALL_RANGES
    assert layers_of(out) == layers_of(plain / "auto")
    assert list((tmp_path / "scratch").iterdir()) == []


def test_the_missing_package_is_named(surveys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "bumpytiles._dask", raising=False)
    monkeypatch.delitem(vars(bumpytiles), "workers_at", raising=False)
    result = map_on("tcp://127.0.0.1:9", surveys, tmp_path / "layers")
    assert (result.exit_code, install_command("dask") in result.output) == (2, True)


@pytest.mark.later
@pytest.mark.parametrize(
    ("address", "warned"),
    [
        ("192.0.2.1:8786", True),
        ("tcp://127.0.0.1:8786", False),
        ("tcp://localhost:8786", False),
        ("tcp://[::1]:8786", False),
    ],
)
@pytest.mark.usefixtures("distributed")
def test_a_scheduler_elsewhere_without_tls_is_warned_about(tmp_path, monkeypatch, address, warned):
    def nobody(*_):
        raise ClusterError("nobody")

    monkeypatch.setattr("bumpytiles.workers_at", nobody)
    result = map_on(address, SURVEY, tmp_path / "out", "--local")
    assert (result.exit_code, "can run programs as the user" in result.output) == (2, warned)


@pytest.mark.later
@pytest.mark.usefixtures("distributed")
def test_the_commands_of_the_page_work(tmp_path):
    """As a user follows them, in one folder and with addresses of this machine."""
    if shutil.which("openssl") is None:
        pytest.skip("needs the program openssl")
    making, starting, mapping = re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "flights").mkdir()
    shutil.copy(SURVEY, tmp_path / "flights")
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    how = {"cwd": tmp_path, "env": os.environ | {"PATH": programs}, "shell": True}
    subprocess.run(making, check=True, capture_output=True, **how)
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        port = place.getsockname()[1]
    scheduler, worker = starting.replace("10.0.0.1:8786", f"127.0.0.1:{port}").splitlines()
    line = mapping.replace("10.0.0.1:8786", f"127.0.0.1:{port}").strip()
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    begun = [
        subprocess.Popen(f"exec python -m distributed.cli.dask_{command}", **how, **quiet)
        for command in (
            f"{scheduler.removeprefix('dask ')} --host 127.0.0.1 --port {port} --no-dashboard",
            f"{worker.removeprefix('dask ')} --no-dashboard",
        )
    ]
    try:
        done = subprocess.run(f"{line} --local --xy-unit m", check=False, capture_output=True, text=True, **how)
    finally:
        for process in begun:
            process.terminate()
        for process in begun:
            process.wait()
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    assert (tmp_path / line.partition("--out ")[2].split()[0] / "rasters/class.tif").exists()
