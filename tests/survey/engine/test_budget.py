"""The memory of a run: how much of what is free is used by default, and how it is divided."""

from dataclasses import replace
from pathlib import Path

import pytest

from bumpymap.core import MapConfig, UsageError, memory as memory_module, memory_bytes
from bumpymap.survey import Budget, with_memory
from bumpymap.survey.engine.budget import POINT_BYTES, requests_at_once

GIB = 1 << 30
CONFIG = MapConfig((Path("a.laz"),), Path("out"))


@pytest.mark.parametrize(
    ("free", "size"),
    [
        (16 * GIB, "4096MB"),
        (1 * GIB, "512MB"),
        (0, "512MB"),
        (999 * GIB, "8192MB"),
        (None, "1024MB"),
    ],
)
def test_by_default_a_run_takes_a_quarter_of_what_is_free(monkeypatch, free, size):
    monkeypatch.setattr(memory_module, "free_memory", lambda: free)
    assert with_memory(CONFIG).memory == size


def test_workers_elsewhere_get_the_same_on_every_machine(monkeypatch):
    monkeypatch.setattr(memory_module, "free_memory", lambda: 100 * GIB)
    assert with_memory(replace(CONFIG, scheduler="tcp://10.0.0.1:8786")).memory == "1024MB"


def test_a_size_that_is_given_is_used():
    config = replace(CONFIG, memory="700 MB")
    assert with_memory(config) is config
    assert memory_bytes(with_memory(replace(CONFIG, memory=" Auto ")).memory) >= 512 << 20
    with pytest.raises(UsageError, match=r"`memory` is 'automatic'; it must be a size of .* or auto"):
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
