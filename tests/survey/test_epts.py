"""A map of an EPT: the layers of the same points in one file; it is known again, and noticed if it has changed."""

import json
import os

import numpy as np
import pytest
from alike_surveys import alike_surveys
from epts import write_ept
from small_surveys import layers_of, run, write_las, write_survey

from bumpymap.readers import hash_survey
from bumpymap.survey.engine.collector import Checkpoints

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A LAZ file, and an EPT of its points whose nodes have offsets of their own."""
    folder, rng = tmp_path_factory.mktemp("made"), np.random.default_rng(1)
    x, y = rng.uniform(0.01, 190.0, (2, 100_000))
    z = 0.2 * np.sin(9 * x) * np.sin(8 * y)
    file = write_las(folder / "site.laz", x + 500_016.0, y + 4_000_032.0, z, classification=rng.integers(1, 7, 100_000))
    return file, write_ept(folder / "site", file, levels=2, split=1, offsets=True)


@pytest.fixture
def ept(made, tmp_path):
    """An EPT that a test may spoil."""
    return write_ept(tmp_path / "site", made[0], levels=1)


@pytest.fixture
def tight(monkeypatch):
    """A budget under which a small survey is read in many pieces, and its first blocks are finished early."""
    for name, points in (("chunk_points", 5_000), ("waiting_points", 20_000), ("block_points", 20_000)):
        monkeypatch.setattr(f"bumpymap.survey.engine.budget.Budget.{name}", points)


def test_the_layers_are_those_of_the_same_points_in_one_file(made, tmp_path, tight):
    with alike_surveys():
        results = [run("map", place, "--out", tmp_path / str(n)) for n, place in enumerate((made[0], made[1].parent))]
    assert [result.exit_code for result in results] == [0, 0], results[1].output
    assert layers_of(tmp_path / "1") == layers_of(tmp_path / "0")


def test_an_ept_is_one_input_and_known_again(made, tmp_path):
    path, out = made[1], tmp_path / "out"
    (told,) = json.loads(run("info", path.parent, "--quick", "--json").stdout)["files"]
    assert (told["path"], told["format"].split(" (")[0]) == (str(path), "EPT of 21 nodes")
    assert run("map", path, "--out", out).exit_code == 0
    record = json.loads((out / "run.json").read_text())
    (known,) = record["inputs"]
    assert (known["path"], known["points"], record["survey"]["name"]) == (str(path), 100_000, "site")
    assert known["bytes"] == sum(file.stat().st_size for file in path.parent.rglob("*.*"))
    assert known["checksum"] == record["survey"]["checksum"] == hash_survey(path)
    node = path.parent / "ept-data/1-0-0-0.laz"
    os.utime(node, ns=(0, node.stat().st_mtime_ns + 1_000_000_000))
    assert run("map", path, "--out", out).output.startswith("Already done")
    spoilt = bytearray(whole := node.read_bytes())
    spoilt[-100] ^= 1
    node.write_bytes(spoilt)
    changed = run("map", path, "--out", out)
    node.write_bytes(whole)
    assert (changed.exit_code, "other inputs" in changed.output) == (3, True), changed.output


def test_an_interrupted_run_goes_on(made, tmp_path, tight, monkeypatch):
    out, save = tmp_path / "out", Checkpoints.save

    def interrupt(checkpoints, result):
        save(checkpoints, result)
        if result.tiles:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoints, "save", interrupt)
        assert run("map", made[1], "--out", out).exit_code == 130
    assert list(out.glob(".bumpymap-run/tiles-*.pack"))
    assert run("map", made[1], "--out", out).exit_code == 0
    assert run("map", made[1], "--out", tmp_path / "at once").exit_code == 0
    assert layers_of(out) == layers_of(tmp_path / "at once")


def test_an_ept_with_a_damaged_node_is_skipped_as_a_whole(ept, tmp_path):
    good = write_survey(tmp_path / "good.laz")
    node = ept.parent / "ept-data/1-1-1-0.laz"
    data = bytearray(node.read_bytes())
    data[-3000:-100] = bytes(2900)
    node.write_bytes(data)
    assert run("map", good, "--out", tmp_path / "alone").exit_code == 0
    result = run("map", tmp_path, "--out", tmp_path / "out", "--skip-bad")
    assert result.exit_code == 4, result.output
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert [*record["skipped"]] == [str(ept)]
    assert str(node) in record["skipped"][str(ept)]
    assert layers_of(tmp_path / "out") == layers_of(tmp_path / "alone")
