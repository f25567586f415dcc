"""The compiled loops: the same bits on every processor, arrays as they come, no memory made executable."""

import ctypes
import os
import re
import subprocess
import sys
import weakref
from pathlib import Path

import numpy as np
import pytest
from small_surveys import write_survey

from bumpytiles import _loops_base, loops_of

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "sample_data" / "quarry_part.ply"
SOURCES = [*(ROOT / "bumpymap").rglob("*.cpp"), *(ROOT / "tiles").rglob("*.cpp")]


def run(*words, **settings):
    command = [sys.executable, "-m", "bumpymap", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, **settings)
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.slow
@pytest.mark.skipif(not _loops_base.runs_v3(), reason="this processor has no AVX2: there is one build for it")
def test_both_builds_map_the_same_bits(tmp_path):
    for name in ("base", "v3"):
        run("map", SAMPLE, "--local", "--out", tmp_path / name, env={**os.environ, "BUMPYMAP_LOOPS": name})
    layers = [path.relative_to(tmp_path / "v3") for path in (tmp_path / "v3").rglob("*.tif")]
    assert len(layers) > 5
    for layer in (*layers, Path("cost.geojson"), Path("tiles.parquet")):
        assert (tmp_path / "base" / layer).read_bytes() == (tmp_path / "v3" / layer).read_bytes(), layer


def test_an_array_of_another_kind_is_refused_and_none_is_copied():
    count = loops_of("bumpytiles").count_tiles
    tile, first = np.array([3, 3, 9], np.uint8), np.zeros(257, np.int64)
    count(tile, first)
    assert first[[4, 10]].tolist() == [2, 1]
    fixed = first.copy()
    fixed.flags.writeable = False
    for wrong in ((tile.astype(np.int64), first), (np.repeat(tile, 2)[::2], first), (tile, fixed), (tile, first[None])):
        with pytest.raises(TypeError, match="incompatible function arguments"):
            count(*wrong)


def test_arrays_that_a_record_makes_for_a_call_live_until_its_end():
    """Each field is a new array, to which nothing else refers."""
    made = []

    class Points:
        def __getattr__(self, name):
            assert all(array() is not None for array in made)
            if name == "grid":
                return {"tile_size": 3.0, "pixels": 15}
            values = np.zeros(1, np.int64 if name in ("col", "row", "starts") else np.float64)
            made.append(weakref.ref(values))
            return values

    with pytest.raises(TypeError):  # the second argument is no settings
        loops_of("bumpymap").measure_tiles(Points(), object(), 1, *[np.zeros(1)] * 5)
    assert len(made) > 2
    assert [array() for array in made] == [None] * len(made)


def test_every_loop_lets_other_threads_run():
    bound = [line for path in SOURCES for line in path.read_text("utf-8").splitlines() if ".def(" in line]
    assert all(re.search(r"free_interpreter|runs_v3", line) for line in bound), bound
    assert any("BUMPY_LOOP(" in path.read_text("utf-8") for path in SOURCES)


PR_SET_MDWE, REFUSE_EXEC_GAIN = 65, 1
"""prctl: from now on this process can make no memory executable (Linux 6.3)."""


def _refuse_executable_memory():
    if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_MDWE, REFUSE_EXEC_GAIN, 0, 0, 0):
        os._exit(77)


@pytest.mark.later
def test_no_command_makes_memory_executable(tmp_path):
    """As under systemd's MemoryDenyWriteExecute."""
    probe = [sys.executable, "-c", "pass"]
    if subprocess.run(probe, preexec_fn=_refuse_executable_memory, check=False).returncode == 77:
        pytest.skip("this kernel has no PR_SET_MDWE")
    layers, survey = tmp_path / "layers", write_survey(tmp_path / "site.laz", points=5_000, side=12.0)
    ends = "--from", "500005,4000006", "--to", "500011,4000012"
    scan = tmp_path / "scan.bin"
    np.random.default_rng(0).uniform(-20, 20, (20_000, 4)).astype("<f4").tofile(scan)
    for words in (
        ("map", survey, "--out", layers),
        ("route", layers, *ends, "--out", tmp_path / "way"),
        ("scan", scan, "--set", "columns=4", "--out", tmp_path / "scanned"),
    ):
        run(*words, preexec_fn=_refuse_executable_memory)
