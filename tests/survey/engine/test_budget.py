"""The memory of a run: what is free on a machine or in a container, and how much of that is used by default."""

from dataclasses import replace
from pathlib import Path

import pytest

from bumpymap.core import MapConfig, UsageError
from bumpymap.survey import Budget, memory_bytes, with_memory
from bumpymap.survey.engine import budget
from bumpymap.survey.engine.budget import POINT_BYTES, requests_at_once
from bumpymap.survey.engine.free_memory import free_memory

GIB = 1 << 30
CONFIG = MapConfig((Path("a.laz"),), Path("out"))


def system(folder, groups, files, available=64 * GIB):
    """Write what Linux would show, and return the folders: the groups of the process, and files by path."""
    texts = {
        "proc/meminfo": f"MemTotal: 99 kB\nMemAvailable:   {available // 1024} kB\nHugePages_Total: 0\n",
        "proc/self/cgroup": groups,
        **{f"cgroup/{path}": text for path, text in files.items()},
    }
    for path, text in texts.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)
    return folder / "proc", folder / "cgroup"


def test_a_machine_without_limits_has_what_is_available(tmp_path):
    files = {"user/memory.max": "max\n", "user/memory.current": "5\n"}
    assert free_memory(*system(tmp_path, "0::/user\n", files)) == 64 * GIB


def test_the_tightest_group_counts_and_copies_of_files_are_no_use(tmp_path):
    files = {
        "a/b/memory.max": f"{8 * GIB}",
        "a/b/memory.current": f"{GIB}",
        "a/memory.max": f"{6 * GIB}",
        "a/memory.current": f"{5 * GIB}",
        "a/memory.stat": f"anon {GIB}\ninactive_file {3 * GIB}\n",
    }
    assert free_memory(*system(tmp_path, "0::/a/b\n", files)) == 4 * GIB
    assert free_memory(*system(tmp_path, "0::/a/b\n", files, available=2 * GIB)) == 2 * GIB


def test_groups_of_the_first_version_count_too(tmp_path):
    files = {
        "memory/jobs/memory.limit_in_bytes": f"{3 * GIB}\n",
        "memory/jobs/memory.usage_in_bytes": f"{2 * GIB}\n",
        "memory/jobs/memory.stat": f"inactive_file 7\ntotal_inactive_file {GIB}\n",
    }
    groups = "5:cpu,cpuacct:/elsewhere\n4:memory:/jobs/one\n0::/\n"
    assert free_memory(*system(tmp_path, groups, files)) == 2 * GIB


@pytest.mark.parametrize("group", ["/docker/0123", "/../../other"])
def test_the_limit_of_a_container_is_in_the_root_that_it_sees(tmp_path, group):
    files = {"memory.max": f"{2 * GIB}\n", "memory.current": f"{3 * GIB}\n"}
    assert free_memory(*system(tmp_path, f"0::{group}\n", files)) == 0


def test_damaged_files_are_no_limits(tmp_path):
    files = {"a/memory.max": "", "a/memory.current": "many"}
    places = system(tmp_path, "0::/a\n", files)
    assert free_memory(*places) == 64 * GIB
    (places[0] / "meminfo").write_text("MemTotal: 1 kB\n")
    installed = free_memory(*places)
    assert installed is None or installed > 1 << 20
    assert free_memory(tmp_path / "none", tmp_path / "none") == installed


@pytest.mark.parametrize(
    ("free", "workers", "memory"),
    [
        (16 * GIB, None, "4096MB"),
        (16 * GIB, 1, "4096MB"),
        (16 * GIB, 4, "1024MB"),
        (1 * GIB, None, "512MB"),
        (0, 3, "512MB"),
        (999 * GIB, None, "8192MB"),
        (999 * GIB, 2, "8192MB"),
        (None, 2, "1024MB"),
    ],
)
def test_by_default_a_run_takes_a_quarter_of_what_is_free(monkeypatch, free, workers, memory):
    monkeypatch.setattr(budget, "free_memory", lambda: free)
    assert with_memory(replace(CONFIG, workers=workers)).memory == memory


def test_workers_elsewhere_get_the_same_on_every_machine(monkeypatch):
    monkeypatch.setattr(budget, "free_memory", lambda: 100 * GIB)
    assert with_memory(replace(CONFIG, scheduler="tcp://10.0.0.1:8786")).memory == "1024MB"


def test_a_size_that_is_given_is_used():
    config = replace(CONFIG, memory="700 MB")
    assert with_memory(config) is config
    assert memory_bytes(with_memory(replace(CONFIG, memory=" Auto ")).memory) >= 512 << 20
    with pytest.raises(UsageError, match=r"memory is 'automatic'; it must be a size of .* or auto"):
        with_memory(replace(CONFIG, memory="automatic"))


def test_points_that_fit_take_their_own_size_and_no_more():
    large = Budget(8 * GIB, 2)
    assert large.waiting_points > 100_000_000
    more = large.most_bytes(20_000_000, 280_000_000) - large.most_bytes(10_000_000, 140_000_000)
    # Each more point waits, and may be in a block that is sorted.
    assert POINT_BYTES * 10_000_000 <= more <= (POINT_BYTES + 63) * 10_000_000
    small = Budget(GIB, 2)
    assert small.most_bytes(10**9, 10**11) == small.most_bytes(10**10, 10**12) <= GIB


@pytest.mark.parametrize(
    ("points", "threads", "requests"),
    [(500_000, 1, 1), (500_000, 2, 1), (50_000, 2, 2), (500_000, 4, 2), (500_000, 16, 5), (50_000, 16, 8)],
)
def test_small_chunks_are_fetched_several_at_a_time(points, threads, requests):
    assert requests_at_once(points, threads) == requests
