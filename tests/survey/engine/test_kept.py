"""What a run keeps that ends early, in its folder and in memory; what a kill leaves, and what becomes of that."""

import errno
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import point_files
import pytest
from small_surveys import files_in, killed_at, layers_of, run, write_las

from bumpymap.cli._output import as_options
from bumpymap.core import MapConfig, UsageError, memory as memory_module, run_folder
from bumpymap.core.errors import OutputError
from bumpymap.core.processes import Child
from bumpymap.core.run_folder import RunFolder, is_interrupted, work_folder
from bumpymap.layers import check_folder
from bumpymap.readers.las import LasSurvey
from bumpymap.survey import with_memory
from bumpymap.survey.engine.budget import Workspace
from bumpymap.survey.engine.collector import Checkpoints
from bumpytiles import Pack

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("without_views")]

GO_ON = "Run the same again to continue from the finished tiles."


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    """Two files, far enough from each other that the blocks of one are complete when the other is read."""
    folder = tmp_path_factory.mktemp("surveys")
    for name, east, count in (("a.laz", 0.0, 15_000), ("b.laz", 144.0, 260_000)):
        rng = np.random.default_rng(int(east))
        x, y = rng.uniform(0.01, 47.0, (2, count))
        z = 0.2 * np.sin(9 * x) * np.sin(8 * y)
        write_las(folder / name, x + 500_016.0 + east, y + 4_000_032.0, z)
    return folder


@pytest.fixture(scope="module")
def plain(surveys, tmp_path_factory):
    out = tmp_path_factory.mktemp("plain") / "layers"
    run("map", surveys, "--out", out, code=0)
    return layers_of(out)


@pytest.fixture(autouse=True)
def tight(limit_points):
    """A budget under which the small surveys are read in many pieces, and their first blocks finished early."""
    limit_points(chunk=5_000, waiting=20_000, block=20_000)


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

    return happen


def goes_on(surveys, out, plain, monkeypatch, *options):
    monkeypatch.undo()
    run("map", surveys, "--out", out, *options, code=0)
    assert layers_of(out) == plain
    assert not (out / ".bumpymap-run").exists()


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
    result = run("map", surveys, "--out", out, "--set", f"scratch={scratch}", code=2)
    assert "the process that decodes LAZ was killed (SIGKILL)" in result.output
    assert result.output.endswith(f"\n{GO_ON}\n")
    assert list(out.glob(".bumpymap-run/tiles-*.pack"))
    (waiting,) = scratch.iterdir()
    assert [folder.stat().st_mode & 0o777 for folder in (waiting, work_folder(out))] == [0o700] * 2
    goes_on(surveys, out, plain, monkeypatch, "--set", f"scratch={scratch}")
    assert list(scratch.iterdir()) == []


def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_keeps_finished_tiles_and_gives_back_what_waits(surveys, plain, tmp_path, monkeypatch, after_tiles):
    after_tiles(lambda: monkeypatch.setattr("bumpytiles.buckets._write", full))
    out, scratch = tmp_path / "out", tmp_path / "scratch"
    result = run("map", surveys, "--out", out, "--set", f"scratch={scratch}", "--overwrite", code=3)
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
    monkeypatch.setattr(LasSurvey, "fetch", lambda self, chunk: fetched.append(chunk.points) or fetch(self, chunk))
    run("map", surveys, "--out", out, code=0)
    assert sum(fetched) <= 60_000, "chunks that are on disk are read again"
    assert layers_of(out) == plain
    assert "memory" not in json.loads((out / "run.json").read_text())["settings"]


def test_a_killed_run_remembers_the_file_that_it_left_out(surveys, tmp_path, monkeypatch):
    left, fetched, fetch = tmp_path / "left", [], LasSurvey.fetch
    content = bytearray((surveys / "a.laz").read_bytes())
    content[-10_000:-9_000] = bytes(1000)
    (tmp_path / "a.laz").write_bytes(content)
    words = (tmp_path / "a.laz", surveys / "b.laz", "--skip-bad")
    killed_at("survey.engine.run.decide_ground", left, *words)
    monkeypatch.setattr(LasSurvey, "fetch", lambda self, chunk: fetched.append(self.info.path) or fetch(self, chunk))
    run("map", *words, "--out", left, code=4)
    assert tmp_path / "a.laz" not in fetched
    assert list(json.loads((left / "run.json").read_text())["skipped"]) == [str(tmp_path / "a.laz")]
    run("map", surveys / "b.laz", "--out", tmp_path / "b", code=0)
    assert layers_of(left) == layers_of(tmp_path / "b")


@pytest.mark.parametrize("spoilt", [True, False])
def test_points_without_the_tiles_that_they_leave_out_are_read_again(surveys, plain, tmp_path, monkeypatch, spoilt):
    """Points of a block that was finished are in no later pack: if a power cut spoils its tiles, no point may miss.

    The run is killed when points are on disk that were read after the first tiles.
    """
    out, left, save, tiles = tmp_path / "out", tmp_path / "left", Checkpoints.save, []

    def killed(checkpoints, result):
        save(checkpoints, result)
        tiles.extend(result.tiles)
        if tiles and result.packs:
            shutil.copytree(out, left)
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoints, "save", killed)
        run("map", surveys, "--out", out, code=130)
    packs = sorted(left.glob(".bumpymap-run/tiles-*-early-*.pack"))
    assert packs
    for pack in packs if spoilt else []:
        pack.write_bytes(pack.read_bytes()[:-9])
    fetched, fetch = [], LasSurvey.fetch
    monkeypatch.setattr(LasSurvey, "fetch", lambda self, chunk: fetched.append(chunk.index) or fetch(self, chunk))
    run("map", surveys, "--out", left, code=0)
    assert layers_of(left) == plain
    assert (fetched[0] == 0) == spoilt  # else it goes on where it was


BLOCKS = 10
POINTS = 30_000


@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    """A strip of ten blocks: a file of each, which reaches into the next one."""
    folder = tmp_path_factory.mktemp("strip")
    rng = np.random.default_rng(0)
    x, y = rng.uniform(480_000.0, 480_000.0 + 48.0 * BLOCKS, POINTS), rng.uniform(3_840_000.0, 3_840_048.0, POINTS)
    ground = np.where(rng.random(POINTS) < 0.3, 2, 1)
    file = np.clip((x - 480_001.0) // 48.0, 0, BLOCKS - 1).astype(int)
    survey = folder / "strip"
    survey.mkdir()
    for number in range(BLOCKS):
        own = file == number
        points = np.column_stack([x[own], y[own], np.zeros(own.sum())])
        data = point_files.las_bytes(points, version="1.4", fmt=7, classification=ground[own])
        (survey / f"{number:02}.las").write_bytes(data)
    run("map", survey, "--out", folder / "whole", "--local", code=0)
    return survey, layers_of(folder / "whole")


@pytest.mark.parametrize(
    ("waiting", "ground", "least", "spills"),
    [
        (21_000, "class", 5, False),
        (2_000, "class", 5, True),
        pytest.param(4_000, "auto", 4, True, marks=pytest.mark.later),
    ],
)
def test_complete_blocks_are_finished_before_points_go_to_disk(
    strip, tmp_path, monkeypatch, limit_points, waiting, ground, least, spills
):
    """And a run that was killed then reads less again, though some files still waited."""
    survey, layers = strip
    left, fetched, fetch = tmp_path / "left", [], LasSurvey.fetch
    limit_points(chunk=500, waiting=waiting)
    killed_at("survey.engine.run.decide_ground", left, survey, "--local", "--ground", ground)
    early, on_disk = (
        {key for path in left.glob(f".bumpymap-run/**/{name}.pack") for key in Pack(path).keys}
        for name in ("tiles-*-early-*", "points-*")
    )
    assert len(early) >= least  # where all points may be ground, a block waits for those around it
    assert bool(on_disk) == bool(early & on_disk) == spills
    monkeypatch.setattr(LasSurvey, "fetch", lambda self, chunk: fetched.append(chunk.points) or fetch(self, chunk))
    run("map", survey, "--out", left, "--local", "--ground", ground, code=0)
    assert sum(fetched) < (0.25 * POINTS if spills else POINTS)
    assert layers_of(left) == layers


ASKED = {"inputs": {"a.laz": {"bytes": 1}}, "settings": {}, "made with": {}, "cut": {"chunk_points": 100}}


def leave_killed(out, scratch):
    """Leave what a kill would leave; gives the folder in which points wait."""
    folders = [folder for folder in (out, scratch) if folder]
    with Workspace.opened(out, scratch, ASKED, overwrite=False) as space:
        (space.scratch / "points-00000000-00000001.pack").write_bytes(b"")
        waiting = space.scratch
        for folder in folders:
            shutil.copytree(folder, folder.with_name(f"{folder.name} kept"))
    for folder in folders:
        shutil.rmtree(folder)
        shutil.move(folder.with_name(f"{folder.name} kept"), folder)
    return waiting


@pytest.mark.parametrize("overwrite", [True, False])
def test_points_that_waited_elsewhere_go_away(tmp_path, overwrite):
    out, one, other = tmp_path / "out", tmp_path / "one", tmp_path / "other"
    waiting = leave_killed(out, one)
    assert list(waiting.iterdir())
    with Workspace.opened(out, other, ASKED, overwrite=overwrite) as space:
        assert not waiting.exists()
        assert space.scratch.is_dir()
    waiting = leave_killed(out, None)
    assert waiting.parent == work_folder(out)
    with Workspace.opened(out, other, ASKED, overwrite=overwrite):
        assert not waiting.exists()
    assert list(out.iterdir()) == list(one.iterdir()) == list(other.iterdir()) == []


def test_a_kill_during_the_clearing_leaves_nothing_to_go_on_with(tmp_path, monkeypatch):
    out = tmp_path / "out"
    with monkeypatch.context() as patch, Workspace.opened(out, None, ASKED, overwrite=False) as space:
        (space.folder / "tiles-all-000000.pack").write_bytes(b"tiles")
        patch.setattr("bumpymap.core.run_folder.remove_path", lambda *_, **__: None)
    assert not work_folder(out).exists()
    (left,) = out.iterdir()
    assert (left / "tiles-all-000000.pack").exists()
    check_folder(out, overwrite=False)
    assert list(out.iterdir()) == []


def precious(folder):
    """Somebody else's folder, with files that have the names of a run's."""
    (folder / "cluster-tiles").mkdir(parents=True)
    for name in ("run_spec.json", "tiles-all-000000.pack", "points-00000000-00000001.pack", "cluster-tiles/a"):
        (folder / name).write_text("mine")
    return folder


def test_a_work_folder_that_is_a_link_is_left_alone(tmp_path):
    mine = precious(tmp_path / "mine")
    before = files_in(mine)
    (tmp_path / "out").mkdir()
    work_folder(tmp_path / "out").symlink_to(mine)
    assert not is_interrupted(tmp_path / "out")
    for overwrite in (True, False):
        opened = Workspace.opened(tmp_path / "out", tmp_path / "scratch", ASKED, overwrite=overwrite)
        with pytest.raises(OutputError, match="is a link"), opened:
            pass
    assert files_in(mine) == before


@pytest.mark.parametrize("overwrite", [True, False])
def test_links_in_a_work_folder_are_taken_away_and_not_followed(tmp_path, overwrite):
    mine = precious(tmp_path / "mine")
    before = files_in(mine)
    work = work_folder(tmp_path / "out")
    (work / "points" / "deep").mkdir(parents=True)
    (work / "run_spec.json").write_text(json.dumps(ASKED))
    for name in ("cluster-tiles", "points/cluster-points", "points/deep/a"):
        (work / name).symlink_to(mine)
    (work / ".tiles-all-000000.pack.part").symlink_to(mine / "run_spec.json")
    (work / "tiles-all-000001.pack").symlink_to(mine / "none")
    with Workspace.opened(tmp_path / "out", None, ASKED, overwrite=overwrite) as space:
        assert not [path for path in space.folder.rglob("*") if path.is_symlink()]
    assert files_in(mine) == before
    assert not work.exists()


def test_a_link_that_is_put_in_the_place_of_the_work_folder_meanwhile_is_not_followed(tmp_path, monkeypatch):
    """Between the look at the folder and its clearing, and again before it is removed."""
    mine = precious(tmp_path / "mine")
    before = files_in(mine)
    work = work_folder(tmp_path / "out")
    work.mkdir(parents=True)
    (work / "run_spec.json").write_text(json.dumps(ASKED))
    listdir = os.listdir

    def swapped(place):
        work.rename(tmp_path / "away")
        work.symlink_to(mine)
        return listdir(place)

    with monkeypatch.context() as patch:
        patch.setattr(run_folder.os, "listdir", swapped)
        run_folder.clean_folder(work, everything=True)
    assert files_in(mine) == before
    assert list((tmp_path / "away").iterdir()) == []
    work.unlink()
    with RunFolder.opened(tmp_path / "out", ASKED, overwrite=False, finished=lambda _: False, advice="") as run:
        run.path.rename(tmp_path / "elsewhere")
        run.path.symlink_to(mine)
    assert files_in(mine) == before
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("fits", ["nothing", "owner", "all but a link"])
def test_a_noted_scratch_folder_that_is_not_the_runs_is_left_alone(tmp_path, fits):
    """What is noted may name any folder: of another run, of another user, a link."""
    out, mine = tmp_path / "out", precious(tmp_path / "bumpymap-mine")
    work = work_folder(out)
    work.mkdir(parents=True)
    (work / "run_spec.json").write_text(json.dumps(ASKED))
    place, word = mine, "a word"
    if fits != "nothing":
        owner = {"out": str(tmp_path / "other" if fits == "owner" else out), "word": word}
        (mine / "owner.json").write_text(json.dumps(owner))
    if fits == "all but a link":
        place = tmp_path / "scratch" / "bumpymap-link"
        place.parent.mkdir()
        place.symlink_to(mine)
    (work / "scratch.json").write_text(json.dumps({"out": str(out), "word": word, "path": str(place)}))
    before = files_in(mine)
    for overwrite in (False, True):
        with Workspace.opened(out, tmp_path / "scratch", ASKED, overwrite=overwrite) as space:
            assert space.scratch != place
        assert files_in(mine) == before


CONFIG = MapConfig((Path("a.laz"),), Path("out"))


@pytest.mark.parametrize(
    ("free_gib", "size"), [(16, "4096MB"), (1, "512MB"), (0, "512MB"), (999, "8192MB"), (None, "1024MB")]
)
def test_by_default_a_run_takes_a_quarter_of_what_is_free(monkeypatch, free_gib, size):
    """And workers elsewhere get the same on every machine."""
    monkeypatch.setattr(memory_module, "free_memory", lambda: free_gib and free_gib << 30)
    assert with_memory(CONFIG).memory == with_memory(replace(CONFIG, memory=" Auto ")).memory == size
    assert with_memory(replace(CONFIG, scheduler="tcp://10.0.0.1:8786")).memory == "1024MB"


def test_a_size_that_is_given_is_used():
    config = replace(CONFIG, memory="700 MB")
    assert with_memory(config) is config
    with pytest.raises(UsageError, match=r"`memory` is 'automatic'; it must be a size of .* or auto"):
        with_memory(replace(CONFIG, memory="automatic"))
