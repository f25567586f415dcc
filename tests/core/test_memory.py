"""What is free on a machine or in a container."""

import pytest

from bumpymap.core import free_memory

GIB = 1 << 30


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
