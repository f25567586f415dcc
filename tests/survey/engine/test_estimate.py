"""What `info` says before a run, held against what runs take."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from ply_files import write_ply
from small_surveys import write_las

from bumpymap.cli import main
from bumpymap.layers import write_products as write
from bumpymap.readers import ReadOptions, open_survey
from bumpymap.survey import Budget, estimate
from bumpytiles import Grid

pytestmark = pytest.mark.slow

QUARRY = Path(__file__).resolve().parents[3] / "sample_data" / "quarry.laz"


def write_points(path, points, ground=False):
    return write_las(path, *points.T, crs=None, classification=np.where(ground, 2, 1) * np.ones(len(points), np.uint8))


def bytes_in(folder, names="*"):
    return sum(path.stat().st_size for path in folder.rglob(names) if path.is_file())


def map_and_look(surveys, folder, budget, monkeypatch):
    """Map; gives what was foretold, and the bytes on disk before the layers were written, and after.

    Records of a run that do not grow with the map (settings, lists of what was read) are left out.
    """
    for name, most in zip(("waiting_points", "chunk_points"), budget, strict=True):
        monkeypatch.setattr(Budget, name, most)
    foretold = estimate([open_survey(path, ReadOptions()).info for path in surveys], Grid(), Budget(1 << 30, 2))
    found = {}

    def write_products(*arguments, **options):
        found["scratch"] = bytes_in(folder / "scratch", "*.pack")
        found["tiles"] = bytes_in(folder / "layers", "*.pack")
        return write(*arguments, **options)

    monkeypatch.setattr("bumpymap.layers.write_products", write_products)
    options = ["--out", folder / "layers", "--set", f"scratch={folder / 'scratch'}", "--local", "--quiet"]
    result = CliRunner().invoke(main, ["map", *map(str, [*surveys, *options])])
    assert result.exit_code == 0, result.output
    found["layers"] = bytes_in(folder / "layers")
    found["count"] = json.loads((folder / "layers" / "run.json").read_text())["counts"]["tiles"]
    return foretold, found


def full_tiles(folder, files, west, side, points_a_pixel):
    """Surveys in a row, 48 m (a block) from one to the next: points in nearly every pixel, some of them ground."""
    rng = np.random.default_rng(0)
    surveys = []
    for number in range(files):
        count = int(points_a_pixel * (side / 0.2) ** 2)
        points = rng.uniform(0, 1, (count, 3)) * (side, side, 3) + (west + 48 * number, 4_000_034, 0)
        surveys.append(write_points(folder / f"{number}.las", points, ground=rng.random(count) < 0.5))
    return surveys


def test_tiles_and_layers_take_nearly_what_was_said_and_no_more(tmp_path, monkeypatch):
    # Each file fills a block of its own (they begin at multiples of 48 m): it is complete, and measured both for its
    # ground and for all points, before it is known which will count. Random heights cannot be compressed.
    surveys = full_tiles(tmp_path, 5, 499_970, 44, 3)
    foretold, found = map_and_look(surveys, tmp_path, (180_000, 50_000), monkeypatch)
    assert found["count"] == foretold.tiles == 5 * 16 * 16
    taken = found["tiles"] + found["layers"]
    assert 0.76 * foretold.out < taken <= foretold.out


def test_points_that_wait_take_nearly_what_was_said_and_no_more(tmp_path, monkeypatch):
    # Each file reaches into the block of the next one: all points wait for the last file.
    surveys = [*full_tiles(tmp_path, 3, 499_990, 44, 1)]
    surveys.append(write_points(tmp_path / "all.las", np.array([[499_990.0, 4_000_034, 0], [500_150.0, 4_000_080, 0]])))
    foretold, found = map_and_look(surveys, tmp_path, (15_000, 4_000), monkeypatch)
    assert 0.85 * foretold.scratch < found["scratch"] <= foretold.scratch


@pytest.mark.later
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's own account of a process")
def test_a_run_takes_more_than_a_third_of_the_memory_that_was_said_and_no_more(tmp_path):
    # What the system says of a child when it has ended (ru_maxrss) may be the size of the parent that started it.
    code = """
import re, sys
from bumpymap.cli import main
main(sys.argv[1:], standalone_mode=False)
print(re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read())[1])
"""
    survey = str(QUARRY)
    # How much is held at once depends on what the threads that write layers do at the same time: up to 160 MB.
    held = []
    for out in ("first", "second", "third"):
        options = ["map", survey, "--out", str(tmp_path / out), "--local", "--threads", "2", "--quiet"]
        run = subprocess.run([sys.executable, "-c", code, *options], check=True, capture_output=True, text=True)
        held.append(int(run.stdout) * 1024)
    foretold = json.loads(CliRunner().invoke(main, ["info", survey, "--quick", "--set", "threads=2", "--json"]).stdout)
    assert 1 / 3 < max(held) / foretold["run"]["memory_bytes_at_most"] <= 1


def test_a_survey_larger_than_its_budget_takes_the_budget_and_a_small_one_does_not():
    info = open_survey(QUARRY, ReadOptions()).info

    def memory(files, budget):
        return estimate([info] * files, Grid(), Budget(budget << 30, 2)).memory

    # What waits in memory and what is put in order take a share of any budget; a chunk that is read does not grow.
    assert 0.6 * (2 << 30) < memory(10_000, 4) - memory(10_000, 2) <= 2 << 30
    assert memory(10_000, 4) > 0.6 * (4 << 30)
    assert memory(1, 4) == memory(1, 2)


def test_info_says_what_a_run_takes(tmp_path):
    def told(*words):
        return CliRunner().invoke(main, ["info", *map(str, words)], env={"COLUMNS": "200"}).output

    quick = (QUARRY, "--quick", "--set", "threads=3")
    assert re.search(r"a run with --memory auto \(\d+MB now\) on 3 threads", told(*quick))
    small = told(*quick, "--set", "memory=128MB")
    assert "a run with --memory 128MB on 3 threads" in small
    assert "none: all points fit into memory" in small
    assert "memory is '1MB'" in told(*quick, "--set", "memory=1MB")
    place = np.array([500_001.0, 4_000_002.0, 0.0])
    points = place + np.random.default_rng(0).uniform(0, 9, (100, 3))
    cloud = write_points(tmp_path / "a.las", points)
    ply = write_ply(tmp_path / "a.ply", np.rec.fromarrays(points[:1].T, names="x,y,z"), order="=")
    assert "unknown until the points are read: run without --quick" in told(cloud, ply, "--quick")
    read = json.loads(CliRunner().invoke(main, ["info", str(cloud), str(ply), "--json"]).stdout)["run"]
    assert (read["points"], read["scratch_bytes_at_most"]) == (101, 0)
    assert 2 <= read["tiles_at_most"] <= 10
