"""``map --align``: two strips with a step give the layers of one flight, and the same bytes however they are read."""

import json
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest
from alike_surveys import alike_surveys
from click.testing import CliRunner
from small_surveys import layers_of, write_las

from bumpymap.cli import main
from bumpymap.survey.engine.collector import Checkpoints

pytestmark = pytest.mark.slow

CORNER = (500_016.0, 4_000_032.0, 300.0)
STEP = 0.04


def points(step, seed=0, n=10_000):
    """Two strips of gently rolling ground, 60 m wide, that share half; x, y, z, line.

    5 points per m2 and strip: where a pixel holds points of both, their step is taken for noise, not for relief.
    """
    rng, parts = np.random.default_rng(seed), []
    for line in (1, 2):
        x, y = rng.uniform(0, 60, n) + 30 * (line - 1), rng.uniform(0, 36, n)
        z = 0.5 * np.sin(x / 7) + 0.02 * np.sin(2 * y) + 0.005 * rng.normal(size=x.size)
        z += step * (line == 2)
        parts.append(np.column_stack([x.round(3), y.round(3), z.round(4), np.full(x.size, line)]))
    return np.concatenate(parts)


def write(path, rows):
    line, scales = rows[:, 3].astype(np.uint16), (0.001, 0.001, 0.0001)
    return write_las(path, *(rows[:, :3] + CORNER).T, offset=CORNER, scales=scales, point_source_id=line)


def mapped(out, *words):
    with alike_surveys():
        result = CliRunner().invoke(main, ["map", "--out", str(out), *map(str, words)])
    assert result.exit_code == 0, result.output
    return result.output


def lines_of(out):
    return json.loads((out / "run.json").read_text())["flight_lines"]


def overlap_c_r(out):
    """Median ride cost of the tiles that both strips cover."""
    tiles = pq.read_table(out / "tiles.parquet", columns=["col", "c_r"]).to_pydict()
    east = np.array(tiles["col"]) * 3 - CORNER[0]
    return float(np.nanmedian(np.array(tiles["c_r"], float)[(east >= 30) & (east < 57)]))


@pytest.fixture(scope="module")
def stepped(tmp_path_factory):
    return write(tmp_path_factory.mktemp("stepped") / "a.laz", points(STEP))


@pytest.fixture(scope="module")
def aligned(stepped, tmp_path_factory):
    out = tmp_path_factory.mktemp("aligned") / "layers"
    said = mapped(out, stepped, "--align", "on")
    assert "an offset of each line was taken off" in " ".join(said.split())
    return out


def test_a_step_is_reported_and_reads_as_roughness(stepped, aligned, tmp_path):
    single = write(tmp_path / "single.laz", points(0.0))
    mapped(tmp_path / "single", single)
    said = mapped(tmp_path / "report", stepped)
    assert "heights of 1 and 2 differ by 4.0 cm" in " ".join(said.split())
    (pair,) = lines_of(tmp_path / "report")["pairs"]
    assert abs(pair["step"] - STEP) < 0.002
    wanted, rough, smooth = (overlap_c_r(out) for out in (tmp_path / "single", tmp_path / "report", aligned))
    assert rough > 1.1 * wanted
    assert smooth == pytest.approx(wanted, rel=0.05)
    assert lines_of(aligned)["pairs"][0]["largest"] < 0.002
    assert lines_of(aligned)["before"] == lines_of(tmp_path / "report")["pairs"]


def test_off_measures_nothing_and_report_changes_no_height(stepped, tmp_path):
    for align in ("off", "report"):
        mapped(tmp_path / align, stepped, "--align", align)
    assert layers_of(tmp_path / "off") == layers_of(tmp_path / "report")
    assert lines_of(tmp_path / "off") == {"lines": 0, "pairs": [], "method": "none", "corrections": [], "before": []}
    again = mapped(tmp_path / "report", stepped)
    assert "Already done" in again
    assert "heights of 1 and 2 differ" in " ".join(again.split())


@pytest.mark.parametrize("on_cluster", [False, pytest.param(True, marks=pytest.mark.later)])
def test_files_order_chunks_and_threads_change_no_byte(aligned, tmp_path, monkeypatch, request, on_cluster):
    workers = ("--set", f"scheduler={request.getfixturevalue('dask_scheduler')}") if on_cluster else ()
    monkeypatch.setattr("bumpymap.survey.engine.budget.Budget.chunk_points", 2_000)
    monkeypatch.setattr("bumpymap.survey.engine.budget.Budget.waiting_points", 6_000)
    rows = np.random.default_rng(5).permutation(points(STEP))
    files = [write(tmp_path / f"{n}.las", part) for n, part in enumerate(np.array_split(rows, 3))][::-1]
    mapped(tmp_path / "out", *files, "--align", "on", "--threads", 2, *workers)
    assert layers_of(tmp_path / "out") == layers_of(aligned)
    assert lines_of(tmp_path / "out") == lines_of(aligned)


def test_a_resumed_run_gives_the_same_bytes(aligned, tmp_path, monkeypatch):
    out, left, survey = tmp_path / "out", tmp_path / "left", write(tmp_path / "a.las", points(STEP))
    save = Checkpoints.save

    def killed(checkpoints, result):
        save(checkpoints, result)
        if result.packs:
            shutil.copytree(out, left)
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("bumpymap.survey.engine.budget.Budget.chunk_points", 2_000)
        patch.setattr("bumpymap.survey.engine.budget.Budget.waiting_points", 6_000)
        patch.setattr(Checkpoints, "save", killed)
        words = ["map", str(survey), "--out", str(out), "--align", "on"]
        assert CliRunner().invoke(main, words).exit_code == 130
    mapped(left, survey, "--align", "on")
    assert layers_of(left) == layers_of(aligned)
    assert lines_of(left) == lines_of(aligned)


def test_info_tells_the_step_of_a_file_and_of_all(stepped, tmp_path):
    said = CliRunner().invoke(main, ["info", str(stepped), "--json"])
    (file,) = json.loads(said.stdout)["files"]
    assert abs(file["flight_lines"]["pairs"][0]["step"] - STEP) < 0.002
    rows = points(STEP)
    files = [write(tmp_path / f"{line}.laz", rows[rows[:, 3] == line]) for line in (1, 2)]
    text = " ".join(CliRunner().invoke(main, ["info", *map(str, files)]).output.split())
    assert "heights of 1 and 2 differ by 4.0 cm" in text
    assert "--align on takes an offset of each line off" in text
