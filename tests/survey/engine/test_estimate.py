"""What `info` says before a run, held against what runs take."""

import json
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings, strategies as st

from bumpymap.cli import main
from bumpymap.readers import ReadOptions, open_survey
from bumpymap.survey import Budget, estimate
from bumpymap.survey.engine import run
from bumpymap.survey.engine.resource_estimate import most_tiles
from bumpytiles import Bounds, Grid

QUARRY = Path(__file__).resolve().parents[3] / "sample_data" / "quarry.laz"


def write(path, points):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = (500_000, 4_000_000, 0), (0.001, 0.001, 0.001)
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.write(path)
    return path


def bytes_in(folder):
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@settings(max_examples=4, deadline=None)
@given(
    seed=st.integers(0, 99),
    span=st.sampled_from([5.0, 60.0, 400.0]),
    files=st.integers(1, 3),
    waiting=st.integers(500, 4_000),
)
def test_a_run_takes_no_more_disk_than_was_said(tmp_path_factory, seed, span, files, waiting):
    folder = tmp_path_factory.mktemp("survey")
    rng = np.random.default_rng(seed)
    surveys = []
    for number in range(files):
        corner = (500_000 + number * span * rng.integers(2), 4_000_000, 0)
        points = rng.uniform(0, span, (3_000, 3)) + corner
        surveys.append(write(folder / f"{number}.las", points))
    infos = [open_survey(path, ReadOptions()).info for path in surveys]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Budget, "waiting_points", waiting)
        patch.setattr(Budget, "chunk_points", 400)
        told = estimate(infos, Grid(), Budget(1 << 30, 2))
        taken = {}

        def looked_at(*arguments, **options):
            finish(*arguments, **options)
            taken["scratch"] = bytes_in(folder / "scratch")
            taken["out"] = bytes_in(folder / "layers") - (folder / "layers/.bumpymap-run/run_spec.json").stat().st_size

        finish = run._finish
        patch.setattr(run, "_finish", looked_at)
        options = ["--out", folder / "layers", "--scratch", folder / "scratch", "--local"]
        result = CliRunner().invoke(main, ["map", *map(str, [*surveys, *options])])
    assert result.exit_code == 0, result.output
    spilled = 3_000 * files > waiting
    assert (taken["scratch"] > 0) <= spilled
    assert taken["scratch"] <= told.scratch
    record = json.loads((folder / "layers" / "run.json").read_text())
    assert record["counts"]["tiles"] <= told.tiles
    # Headers of packs and of layers weigh much in so small a map.
    assert taken["out"] + bytes_in(folder / "layers") <= told.out + 200_000


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's own account of a process")
def test_a_run_takes_no_more_memory_than_was_said(tmp_path):
    # What the system says of a child when it has ended (ru_maxrss) may be the size of the parent that started it.
    code = """
import re, sys
from bumpymap.cli import main
main(sys.argv[1:], standalone_mode=False)
print(re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read())[1])
"""
    options = ["map", str(QUARRY), "--out", str(tmp_path), "--threads", "2", "--quiet"]
    said = subprocess.run([sys.executable, "-c", code, *options], check=True, capture_output=True, text=True).stdout
    told = json.loads(CliRunner().invoke(main, ["info", str(QUARRY), "--quick", "--threads", "2", "--json"]).stdout)
    assert int(said) * 1024 <= told["run"]["memory_bytes_at_most"]


def test_bounds_hold_for_any_size_and_grow_with_it():
    info = open_survey(QUARRY, ReadOptions()).info
    budget = Budget(256 << 20, 2)
    before = 0
    for files in (1, 2, 10, 1000):
        told = estimate([info] * files, Grid(), budget)
        assert told.points == files * info.point_count
        assert told.memory <= (620 << 20) + budget.memory
        if told.points <= budget.waiting_points:
            assert told.scratch == 0
        else:
            assert 26 * told.points < told.scratch < 28 * told.points
        assert told.seconds > before
        before = told.seconds


def test_tiles_are_counted_from_boxes():
    grid = Grid(3.0)
    box = Bounds(-0.1, 0.0, 3.0, 2.9)
    assert most_tiles([box], 100, grid) == 3  # columns -1, 0 and 1
    assert most_tiles([box, box], 100, grid) == 6
    assert most_tiles([box], 2, grid) == 2
    assert most_tiles([box, None], 100, grid) is None


def test_info_says_what_a_run_takes(tmp_path):
    def told(*words):
        return CliRunner().invoke(main, ["info", str(QUARRY), "--quick", *words], env={"COLUMNS": "200"}).output

    assert "a run with --memory 1GB on 3 threads" in told("--threads", "3")
    assert "none: all points fit into memory" in told()
    small = told("--memory", "128MB", "--threads", "1")
    assert "on 1 thread\n" in small
    assert "scratch  none" in small
    assert "memory is '1MB'" in told("--memory", "1MB")
    place = np.array([500_001.0, 4_000_002.0, 0.0])
    cloud = write(tmp_path / "a.las", place + np.random.default_rng(0).uniform(0, 9, (100, 3)))
    ply = tmp_path / "a.ply"
    axes = "".join(f"property double {axis}\n" for axis in "xyz")
    ply.write_text(f"ply\nformat ascii 1.0\nelement vertex 1\n{axes}end_header\n1 2 3\n")
    both = CliRunner().invoke(main, ["info", str(cloud), str(ply), "--quick"], env={"COLUMNS": "200"}).output
    assert "unknown until the points are read: run without --quick" in both
    read = json.loads(CliRunner().invoke(main, ["info", str(cloud), str(ply), "--json"]).stdout)["run"]
    assert (read["points"], read["scratch_bytes_at_most"]) == (101, 0)
    assert 2 <= read["tiles_at_most"] <= 10
    bad = tmp_path / "bad.laz"
    bad.write_bytes(b"nothing")
    assert json.loads(CliRunner().invoke(main, ["info", str(bad), "--json"]).stdout)["run"] is None
