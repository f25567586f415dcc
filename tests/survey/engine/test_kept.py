"""What a run keeps that ends early, by how it ended: finished tiles are not lost to a helper or a disk that fails."""

import errno
import json
import os
import shutil

import numpy as np
import pytest
from small_surveys import layers_of, run, write_las

from bumpymap.cli._text import as_options
from bumpymap.core import CHECKSUM_METHOD
from bumpymap.core.errors import BadInputError, OutputError
from bumpymap.core.processes import Child
from bumpymap.core.run_folder import Kept, what_to_keep
from bumpymap.readers import hash_survey
from bumpymap.readers.las import LasSurvey
from bumpymap.survey.engine.block_work import TileSink
from bumpymap.survey.engine.collector import Checkpoints

pytestmark = pytest.mark.slow

GO_ON = "Run the same again to continue from the finished tiles."


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    """Two files, far enough from each other that the blocks of one are complete when the other is read."""
    folder = tmp_path_factory.mktemp("surveys")
    for name, east, count in (("a.laz", 0.0, 15_000), ("b.laz", 96.0, 260_000)):
        rng = np.random.default_rng(int(east))
        x, y = rng.uniform(0.01, 47.0, (2, count))
        z = 0.2 * np.sin(9 * x) * np.sin(8 * y)
        write_las(folder / name, x + 500_016.0 + east, y + 4_000_032.0, z)
    return folder


@pytest.fixture(scope="module")
def plain(surveys, tmp_path_factory):
    out = tmp_path_factory.mktemp("plain") / "layers"
    assert run("map", surveys, "--out", out).exit_code == 0
    return layers_of(out)


@pytest.fixture(autouse=True)
def tight(monkeypatch):
    """A budget under which the small surveys are read in many pieces, and their first blocks finished early."""
    monkeypatch.setattr("bumpymap.survey.engine.budget.Budget.chunk_points", 5_000)
    monkeypatch.setattr("bumpymap.survey.engine.budget.Budget.waiting_points", 20_000)
    monkeypatch.setattr("bumpymap.survey.engine.budget.Budget.block_points", 20_000)


@pytest.fixture
def after_tiles(monkeypatch):
    """Something that happens once tiles are on the disk."""

    def happen(what):
        save = Checkpoints.save

        def saved(checkpoints, result):
            save(checkpoints, result)
            if result.tiles:
                what()

        monkeypatch.setattr(Checkpoints, "save", saved)

    with monkeypatch.context():
        yield happen


def goes_on(surveys, out, plain, monkeypatch, *options):
    monkeypatch.undo()
    result = run("map", surveys, "--out", out, *options)
    assert result.exit_code == 0, result.output
    assert layers_of(out) == plain
    assert not (out / ".bumpymap-run").exists()


@pytest.mark.skipif(os.name != "posix", reason="the decoder is no process of its own here")
def test_a_decoder_that_is_killed_keeps_everything(surveys, plain, tmp_path, monkeypatch, after_tiles):
    finish = Child.finish

    def kill(child, *supply):
        child.process.kill()
        child.process.wait()
        return finish(child, *supply)

    # One request at a time: otherwise all may have been made before the first tiles are finished.
    monkeypatch.setattr("bumpymap.survey.engine.reading.requests_at_once", lambda *_: 1)
    after_tiles(lambda: monkeypatch.setattr(Child, "finish", kill))
    out, scratch = tmp_path / "out", tmp_path / "scratch"
    result = run("map", surveys, "--out", out, "--set", f"scratch={scratch}")
    assert result.exit_code == 2, result.output
    assert "the process that decodes LAZ was killed (SIGKILL)" in result.output
    assert "Traceback" not in result.output
    assert result.output.endswith(f"\n{GO_ON}\n")
    assert list(out.glob(".bumpymap-run/tiles-*.pack"))
    (waiting,) = scratch.iterdir()
    assert waiting.stat().st_mode & 0o777 == 0o700
    goes_on(surveys, out, plain, monkeypatch, "--set", f"scratch={scratch}")
    assert list(scratch.iterdir()) == []


def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_keeps_finished_tiles_and_gives_back_what_waits(surveys, plain, tmp_path, monkeypatch, after_tiles):
    after_tiles(lambda: monkeypatch.setattr("bumpytiles.buckets._write", full))
    out, scratch = tmp_path / "out", tmp_path / "scratch"
    result = run("map", surveys, "--out", out, "--set", f"scratch={scratch}", "--overwrite")
    assert result.exit_code == 3, result.output
    assert "No space left on device" in result.output
    assert result.output.endswith(f"\n{GO_ON.replace('to the same command', 'in the place of --overwrite')}\n")
    assert list(out.glob(".bumpymap-run/tiles-*.pack"))
    assert list(scratch.iterdir()) == []
    goes_on(surveys, out, plain, monkeypatch)


def test_a_run_goes_on_under_other_memory_without_reading_again(surveys, plain, tmp_path, monkeypatch):
    """Under another limit, which `auto` may give any time, files would be cut into other chunks."""
    out = tmp_path / "out"

    monkeypatch.setattr("bumpymap.survey.engine.run.decide_ground", lambda *_: 1 / 0)  # a defect keeps everything
    failed = run("map", surveys, "--out", out, "--memory", "128MB")
    assert GO_ON in as_options(failed.output + "".join(getattr(failed.exception, "__notes__", [])))
    monkeypatch.undo()
    fetched, fetch = [], LasSurvey.fetch

    def counted(reader, chunk):
        fetched.append(chunk.points)
        return fetch(reader, chunk)

    monkeypatch.setattr(LasSurvey, "fetch", counted)
    result = run("map", surveys, "--out", out)
    assert result.exit_code == 0, result.output
    assert sum(fetched) <= 60_000, "chunks that are on disk are read again"
    assert layers_of(out) == plain
    assert "memory" not in json.loads((out / "run.json").read_text())["settings"]


@pytest.mark.parametrize("method", [CHECKSUM_METHOD, "another-1MiB"])
def test_digests_by_another_method_are_made_again(surveys, tmp_path, monkeypatch, method):
    out, wrong = tmp_path / "out", bytes(32).hex()
    with monkeypatch.context() as patch:
        patch.setattr("bumpymap.survey.engine.run.decide_ground", lambda *_: 1 / 0)
        run("map", surveys, "--out", out)
    records = list(out.glob(".bumpymap-run/**/read-*.json"))
    for path in records:
        record = json.loads(path.read_text())
        record[method] = {file: [[n, wrong] for n, _ in own] for file, own in record.pop(CHECKSUM_METHOD).items()}
        path.write_text(json.dumps(record))
    result = run("map", surveys, "--out", out)
    assert result.exit_code == 0, result.output
    made = [entry["checksum"] for entry in json.loads((out / "run.json").read_text())["inputs"]]
    right = [hash_survey(path) for path in sorted(surveys.iterdir())]
    assert (made == right) == (method != CHECKSUM_METHOD), "what is kept is used, if it is by the same method"


def test_a_full_disk_before_any_tile_leaves_nothing(surveys, tmp_path, monkeypatch):
    monkeypatch.setattr("bumpytiles.buckets._write", full)
    monkeypatch.setattr(TileSink, "flush", lambda _: None)
    result = run("map", surveys, "--out", tmp_path / "out", "--set", f"scratch={tmp_path / 'scratch'}")
    assert result.exit_code == 3
    assert GO_ON not in result.output
    assert not (tmp_path / "out").exists()


def test_a_bad_input_leaves_nothing(surveys, tmp_path, after_tiles):
    for name in ("a.laz", "b.laz"):
        shutil.copy(surveys / name, tmp_path)
    content = bytearray((tmp_path / "b.laz").read_bytes())
    content[-100_000:-99_000] = bytes(1000)
    (tmp_path / "b.laz").write_bytes(content)
    seen = []
    after_tiles(lambda: seen.append(1))
    result = run("map", tmp_path / "a.laz", tmp_path / "b.laz", "--out", tmp_path / "out")
    assert result.exit_code == 3, result.output
    assert seen
    assert GO_ON not in result.output
    assert not (tmp_path / "out").exists()


def test_a_killed_run_remembers_the_file_that_it_left_out(surveys, tmp_path, monkeypatch):
    out, left, fetched, fetch = tmp_path / "out", tmp_path / "left", [], LasSurvey.fetch
    content = bytearray((surveys / "a.laz").read_bytes())
    content[-10_000:-9_000] = bytes(1000)
    (tmp_path / "a.laz").write_bytes(content)
    words = ("map", tmp_path / "a.laz", surveys / "b.laz", "--skip-bad")

    def killed(*_):
        shutil.copytree(out, left)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("bumpymap.survey.engine.run.decide_ground", killed)
        assert run(*words, "--out", out).exit_code == 130
    monkeypatch.setattr(LasSurvey, "fetch", lambda self, chunk: fetched.append(self.info.path) or fetch(self, chunk))
    assert run(*words, "--out", left).exit_code == 4
    assert tmp_path / "a.laz" not in fetched
    assert list(json.loads((left / "run.json").read_text())["skipped"]) == [str(tmp_path / "a.laz")]
    assert run("map", surveys / "b.laz", "--out", tmp_path / "b").exit_code == 0
    assert layers_of(left) == layers_of(tmp_path / "b")


def test_packs_that_a_power_cut_spoilt_are_made_anew(surveys, plain, tmp_path, monkeypatch):
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr("bumpymap.layers.write_products", lambda *_, **__: (_ for _ in ()).throw(OutputError("full")))
        assert run("map", surveys, "--out", out).exit_code == 3
    packs = sorted(out.glob(".bumpymap-run/tiles-*.pack"))
    assert len(packs) > 1
    packs[0].write_bytes(packs[0].read_bytes()[:-9])
    packs[-1].unlink()
    goes_on(surveys, out, plain, monkeypatch)


def killed_after_points(surveys, out, left, monkeypatch):
    """Run until points are on disk that were read after the first tiles; copy what a kill leaves then."""
    save, tiles = Checkpoints.save, []

    def killed(checkpoints, result):
        save(checkpoints, result)
        tiles.extend(result.tiles)
        if tiles and result.packs:
            shutil.copytree(out, left)
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoints, "save", killed)
        assert run("map", surveys, "--out", out).exit_code == 130


@pytest.mark.parametrize("spoilt", [True, False])
def test_points_without_the_tiles_that_they_leave_out_are_read_again(surveys, plain, tmp_path, monkeypatch, spoilt):
    """Points of a block that was finished are in no later pack: if a power cut spoils its tiles, no point may miss."""
    left = tmp_path / "left"
    killed_after_points(surveys, tmp_path / "out", left, monkeypatch)
    packs = sorted(left.glob(".bumpymap-run/tiles-*-early-*.pack"))
    assert packs
    for pack in packs if spoilt else []:
        pack.write_bytes(pack.read_bytes()[:-9])
    fetched, fetch = [], LasSurvey.fetch
    monkeypatch.setattr(LasSurvey, "fetch", lambda self, chunk: fetched.append(chunk.index) or fetch(self, chunk))
    result = run("map", surveys, "--out", left)
    assert result.exit_code == 0, result.output
    assert layers_of(left) == plain
    assert (fetched[0] == 0) == spoilt  # else it goes on where it was


def test_a_server_that_failed_may_answer_the_next_time():
    end = BadInputError("cannot read https://a/b.laz")
    end.__cause__ = TimeoutError()
    assert what_to_keep(end) is Kept.ALL
