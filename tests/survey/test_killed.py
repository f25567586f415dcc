"""Runs that are killed at random instants: the same command goes on, and every file is that of a whole run."""

import os
import random
import subprocess
import sys
import time

import pytest
from small_surveys import layers_of, write_survey

pytestmark = [pytest.mark.later, pytest.mark.skipif(os.name != "posix", reason="kills a group of processes")]

# A budget under which the survey is read in many pieces, which wait on disk, and measured block by block.
TIGHT = """
import sys
from bumpymap.cli import main
from bumpymap.survey import Budget
Budget.chunk_points, Budget.waiting_points, Budget.block_points = 5_000, 20_000, 20_000
main(sys.argv[1:])
"""


def begun(survey, folder):
    """A run in a session of its own, with what it starts."""
    words = ["map", survey, "--out", folder / "layers", "--set", f"scratch={folder / 'scratch'}", "--quiet"]
    return subprocess.Popen([sys.executable, "-c", TIGHT, *map(str, words)], start_new_session=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The survey, its layers, and how long a run takes, s."""
    folder = tmp_path_factory.mktemp("whole")
    survey = write_survey(folder / "site.laz", points=150_000, side=120.0)
    began = time.monotonic()
    assert begun(survey, folder).wait() == 0
    return survey, layers_of(folder / "layers"), time.monotonic() - began


@pytest.mark.parametrize("seed", range(6))
def test_a_run_killed_at_any_instant_once_or_twice_goes_on_to_the_same_bytes(whole, tmp_path, seed):
    survey, layers, seconds = whole
    draw = random.Random(seed)
    for _ in range(1 + seed % 3 // 2):
        run = begun(survey, tmp_path)
        time.sleep(draw.uniform(0.0, seconds))
        run.kill()
        run.wait()
        with pytest.raises(ProcessLookupError):  # noqa: PT012 (its helpers end by themselves)
            for _ in range(50):
                os.killpg(run.pid, 0)
                time.sleep(0.1)
    assert begun(survey, tmp_path).wait() == 0
    assert layers_of(tmp_path / "layers") == layers
    assert not list((tmp_path / "layers").glob(".bumpymap-*"))
    assert list((tmp_path / "scratch").iterdir()) == []
