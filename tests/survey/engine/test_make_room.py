"""Memory is full: complete blocks make room, points go to disk only if that is not enough, and no point is lost."""

import shutil

import las_files
import numpy as np
import pytest
from small_surveys import layers_of, run

from bumpymap.readers.las import LasSurvey
from bumpytiles import Pack

pytestmark = pytest.mark.slow

BLOCKS = 10
POINTS = 30_000


@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    """COPC of a strip of ten blocks: its coarse nodes reach into all of them."""
    folder = tmp_path_factory.mktemp("strip")
    rng = np.random.default_rng(0)
    x, y = rng.uniform(480_000.0, 480_000.0 + 48.0 * BLOCKS, POINTS), rng.uniform(3_840_000.0, 3_840_048.0, POINTS)
    ground = np.where(rng.random(POINTS) < 0.3, 2, 1)
    data = las_files.las_bytes(np.column_stack([x, y, np.zeros(POINTS)]), version="1.4", fmt=7, classification=ground)
    survey = folder / "strip.copc.laz"
    survey.write_bytes(las_files.octree(data, levels=6))
    assert run("map", survey, "--out", folder / "whole", "--local").exit_code == 0
    return survey, layers_of(folder / "whole")


@pytest.mark.parametrize(("waiting", "spills"), [(21_000, False), (4_000, True)])
def test_complete_blocks_are_finished_before_points_go_to_disk(strip, tmp_path, monkeypatch, waiting, spills):
    """And a run that was killed then reads less again, though the coarse nodes still waited."""
    survey, layers = strip
    out, left, fetched, fetch = tmp_path / "out", tmp_path / "left", [], LasSurvey.fetch
    monkeypatch.setattr("bumpymap.survey.engine.budget.Budget.chunk_points", 500)
    monkeypatch.setattr("bumpymap.survey.engine.budget.Budget.waiting_points", waiting)

    def killed(*_):
        shutil.copytree(out, left)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("bumpymap.survey.engine.run.decide_ground", killed)
        assert run("map", survey, "--out", out, "--local").exit_code == 130
    early, on_disk = (
        {key for path in left.glob(f".bumpymap-run/**/{name}.pack") for key in Pack(path).keys}
        for name in ("tiles-*-early-*", "points-*")
    )
    assert len(early) >= BLOCKS // 2
    assert bool(on_disk) == bool(early & on_disk) == spills
    monkeypatch.setattr(LasSurvey, "fetch", lambda self, chunk: fetched.append(chunk.points) or fetch(self, chunk))
    assert run("map", survey, "--out", left, "--local").exit_code == 0
    assert sum(fetched) < (0.25 * POINTS if spills else POINTS)
    assert layers_of(left) == layers
