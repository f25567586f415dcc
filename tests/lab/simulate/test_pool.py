"""Workers of the simulation: no thread of the main process tends them, and they end with it, however it ends."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from bumpymap.core.errors import BumpymapError
from bumpymap.lab.simulate.jobs import drive_jobs

pytestmark = pytest.mark.slow

JOBS = """
import os, time
from dataclasses import dataclass

@dataclass(frozen=True)
class Job:
    key: int
    starts: int = 1

def twice(job): return 2 * job.key
def die(job): os._exit(1)
def never(job):
    print(os.getpid(), flush=True)
    time.sleep(3600)
"""


@pytest.fixture
def jobs(tmp_path, monkeypatch):
    """A module that workers can import."""
    (tmp_path / "pool_jobs.py").write_text(JOBS)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "pool_jobs", raising=False)
    return __import__("pool_jobs")


def test_results_come_in_order_and_the_process_has_no_thread_for_it(jobs):
    before, seen = threading.active_count(), []

    def told(done, total):
        seen.append((done, total, threading.active_count()))

    made = drive_jobs(jobs.twice, [jobs.Job(key) for key in range(7)], told, workers=3)
    assert list(made.items()) == [(key, 2 * key) for key in range(7)]
    assert seen == [(done, 7, before) for done in range(8)]


def test_a_dead_worker_is_reported_with_what_to_do(jobs):
    with pytest.raises(BumpymapError, match="run the same command again"):
        drive_jobs(jobs.die, [jobs.Job(0), jobs.Job(1)], workers=2)


@pytest.mark.later
@pytest.mark.skipif(sys.platform == "win32", reason="kills a process the POSIX way")
def test_workers_end_with_a_main_process_that_was_killed(jobs):
    code = (
        "from bumpymap.lab.simulate.jobs import drive_jobs\n"
        "import pool_jobs\n"
        "drive_jobs(pool_jobs.never, [pool_jobs.Job(0), pool_jobs.Job(1)], workers=2)\n"
    )
    paths = os.pathsep.join([str(Path(jobs.__file__).parent), *filter(None, sys.path)])
    pipe, environment = subprocess.PIPE, os.environ | {"PYTHONPATH": paths}
    main = subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=pipe, stderr=pipe, text=True)
    workers = {int(main.stdout.readline()) for _ in range(2)}
    assert main.pid not in workers
    for worker in workers:
        os.kill(worker, signal.SIGTERM)  # of the whole group: it is for the main process
    main.kill()
    # The workers hold the pipes too: their ends are reached only when all are gone.
    assert main.communicate(timeout=30) == ("", "")
