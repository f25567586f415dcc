"""The memory of a run: how much of what is free is used by default, and how it is divided."""

from dataclasses import replace
from pathlib import Path

import pytest

from bumpymap.core import MapConfig, UsageError, memory as memory_module, memory_bytes
from bumpymap.survey import with_memory

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
