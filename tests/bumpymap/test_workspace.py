"""The folder of a run: what a kill leaves in it, and what becomes of that."""

import shutil

import pytest

from bumpymap.engine.workspace import Workspace
from bumpymap.run_folder import work_folder

ASKED = {"inputs": {"a.laz": 1}, "cut": {"piece_points": 100}}


def killed(out, scratch, asked=ASKED):
    """Leave what a kill would leave; gives the folder in which points wait."""
    kept = out.with_name("kept")
    with Workspace.opened(out, scratch, asked, resume=False) as space:
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


@pytest.mark.parametrize("resume", [True, False])
def test_points_that_waited_elsewhere_go_away(tmp_path, resume):
    out, one, other = tmp_path / "out", tmp_path / "one", tmp_path / "other"
    waiting = killed(out, one)
    assert list(waiting.iterdir())
    with Workspace.opened(out, other, ASKED, resume=resume) as space:
        assert not waiting.exists()
        assert space.scratch.is_dir()
    waiting = killed(out, None)
    assert waiting.parent == work_folder(out)
    with Workspace.opened(out, other, ASKED, resume=resume):
        assert not waiting.exists()
    assert list(out.iterdir()) == list(one.iterdir()) == list(other.iterdir()) == []


def test_a_kill_during_the_clearing_leaves_nothing_to_go_on_with(tmp_path, monkeypatch):
    out = tmp_path / "out"
    with monkeypatch.context() as patch, Workspace.opened(out, None, ASKED, resume=False) as space:
        (space.folder / "tiles-all-000000.pack").write_bytes(b"tiles")
        patch.setattr("bumpymap.engine.workspace.shutil.rmtree", lambda *_, **__: None)
    assert not work_folder(out).exists()
    (left,) = out.iterdir()
    assert (left / "tiles-all-000000.pack").exists()
    from bumpymap.products import check_folder

    check_folder(out, overwrite=False)
    assert list(out.iterdir()) == []
