"""The folder of a run: what a kill leaves in it, and what becomes of that."""

import json
import os
import shutil

import pytest

from bumpymap.core import run_folder
from bumpymap.core.errors import OutputError
from bumpymap.core.run_folder import RunFolder, is_interrupted, work_folder
from bumpymap.survey.engine.budget import Workspace

ASKED = {"inputs": {"a.laz": {"bytes": 1}}, "settings": {}, "made with": {}, "cut": {"chunk_points": 100}}


def killed(out, scratch, run_spec=ASKED):
    """Leave what a kill would leave; gives the folder in which points wait."""
    kept = out.with_name("kept")
    with Workspace.opened(out, scratch, run_spec, overwrite=False) as space:
        (space.scratch / "points-00000000-00000001.pack").write_bytes(b"")
        waiting = space.scratch
        shutil.copytree(out, kept)
        if scratch:
            shutil.copytree(scratch, kept.with_name("kept_scratch"))
    shutil.rmtree(out)
    shutil.move(kept, out)
    if scratch:
        shutil.rmtree(scratch)
        shutil.move(kept.with_name("kept_scratch"), scratch)
    return waiting


@pytest.mark.parametrize("overwrite", [True, False])
def test_points_that_waited_elsewhere_go_away(tmp_path, overwrite):
    out, one, other = tmp_path / "out", tmp_path / "one", tmp_path / "other"
    waiting = killed(out, one)
    assert list(waiting.iterdir())
    with Workspace.opened(out, other, ASKED, overwrite=overwrite) as space:
        assert not waiting.exists()
        assert space.scratch.is_dir()
    waiting = killed(out, None)
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
    from bumpymap.layers import check_folder

    check_folder(out, overwrite=False)
    assert list(out.iterdir()) == []


def precious(folder):
    """Somebody else's folder, with files that have the names of a run's."""
    (folder / "cluster-tiles").mkdir(parents=True)
    for name in (
        ".profile",
        "run_spec.json",
        "tiles-all-000000.pack",
        "points-00000000-00000001.pack",
        "cluster-tiles/a",
    ):
        (folder / name).write_text("mine")
    return folder


def contents(folder):
    return {str(path.relative_to(folder)): path.is_file() and path.read_text() for path in folder.rglob("*")}


def test_the_folders_of_a_run_are_its_users_own(tmp_path):
    with Workspace.opened(tmp_path / "out", tmp_path / "scratch", ASKED, overwrite=False) as space:
        for folder in (space.folder, space.scratch):
            assert folder.stat().st_mode & 0o777 == 0o700
        first = space.scratch.name
    with Workspace.opened(tmp_path / "out", tmp_path / "scratch", ASKED, overwrite=False) as space:
        assert space.scratch.name != first


@pytest.mark.parametrize("overwrite", [True, False])
def test_a_work_folder_that_is_a_link_is_left_alone(tmp_path, overwrite):
    mine = precious(tmp_path / "mine")
    before = contents(mine)
    (tmp_path / "out").mkdir()
    work_folder(tmp_path / "out").symlink_to(mine)
    assert not is_interrupted(tmp_path / "out")
    opened = Workspace.opened(tmp_path / "out", tmp_path / "scratch", ASKED, overwrite=overwrite)
    with pytest.raises(OutputError, match="is a link"), opened:
        pass
    assert contents(mine) == before


@pytest.mark.parametrize("overwrite", [True, False])
def test_links_in_a_work_folder_are_taken_away_and_not_followed(tmp_path, overwrite):
    mine = precious(tmp_path / "mine")
    before = contents(mine)
    work = work_folder(tmp_path / "out")
    (work / "points" / "deep").mkdir(parents=True)
    (work / "run_spec.json").write_text(json.dumps(ASKED))
    for name in ("cluster-tiles", "points/cluster-points", "points/deep/a"):
        (work / name).symlink_to(mine)
    (work / ".tiles-all-000000.pack.part").symlink_to(mine / ".profile")
    (work / "tiles-all-000001.pack").symlink_to(mine / "none")
    with Workspace.opened(tmp_path / "out", None, ASKED, overwrite=overwrite) as space:
        assert not [path for path in space.folder.rglob("*") if path.is_symlink()]
    assert contents(mine) == before
    assert not work.exists()


@pytest.mark.parametrize("overwrite", [True, False])
def test_a_link_that_is_put_in_the_place_of_the_work_folder_meanwhile_is_not_followed(tmp_path, monkeypatch, overwrite):
    """Between the look at the folder and its clearing, and again before it is removed."""
    mine = precious(tmp_path / "mine")
    before = contents(mine)
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
    assert contents(mine) == before
    assert list((tmp_path / "away").iterdir()) == []
    work.unlink()
    with RunFolder.opened(tmp_path / "out", ASKED, overwrite=overwrite, finished=lambda _: False, advice="") as run:
        run.path.rename(tmp_path / "elsewhere")
        run.path.symlink_to(mine)
    assert contents(mine) == before
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
    before = contents(mine)
    for overwrite in (False, True):
        with Workspace.opened(out, tmp_path / "scratch", ASKED, overwrite=overwrite) as space:
            assert space.scratch != place
        assert contents(mine) == before
