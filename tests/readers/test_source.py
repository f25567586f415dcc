"""Files and folders: found once each, and no mixture of two versions."""

import os
import re

import numpy as np
import pytest
from survey_kinds import KINDS, write_kind

import bumpymap.readers.las as las_module
from bumpymap.core.errors import BadInputError
from bumpymap.readers import find_surveys, identity, open_survey


def test_what_is_not_there(tmp_path):
    for where in (tmp_path / "b.laz", tmp_path):
        with pytest.raises(BadInputError, match=rf"cannot read .*(b\.laz|{tmp_path.name})"):
            open_survey(where)
    (tmp_path / "c.laz").touch()
    with pytest.raises(BadInputError, match="is empty"):
        open_survey(tmp_path / "c.laz")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.laz")
        with pytest.raises(BadInputError, match="a pipe or a device"):  # which is not waited for
            open_survey(tmp_path / "pipe.laz")


def test_identity_tells_files_and_versions_apart(tmp_path):
    path, data = tmp_path / "a", bytearray(200_000)
    path.write_bytes(data)
    first = identity(path)
    assert first == identity(path)
    assert first["size"] == 200_000
    os.utime(path, ns=(5, 5))
    touched = identity(path)
    assert touched != first
    assert touched["digest"] == first["digest"]
    for place in (0, 199_999):
        path.write_bytes(data[:place] + b"\1" + data[place + 1 :])
        os.utime(path, ns=(5, 5))
        assert identity(path)["digest"] != first["digest"]


# ---- finding surveys ----


def test_folders_are_searched_with_their_subfolders_and_each_file_counts_once(tmp_path):
    files = ("b.LAZ", "a.las", "c.copc.laz", "sub/d.Ply", "sub/deep/e.pcd", "notes.txt", ".hidden.las", ".git/f.las")
    for name in (*files, "empty/notes.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"x")

    def found(*typed):
        return [str(path.relative_to(tmp_path)) for path in find_surveys(typed)]

    assert found(tmp_path) == found(str(tmp_path)) == sorted(files[:5])
    assert found(tmp_path / "sub", tmp_path / "a.las", tmp_path / "sub/d.Ply") == [
        "a.las",
        "sub/d.Ply",
        "sub/deep/e.pcd",
    ]
    (tmp_path / "z.las").symlink_to(tmp_path / "a.las")
    assert len(found(tmp_path / "a.las", tmp_path / "sub/../a.las", tmp_path / "z.las")) == 1
    assert found(tmp_path / "notes.txt") == ["notes.txt"]  # a named file is taken whatever its ending
    for typed, says in (
        ([tmp_path / "a.las", tmp_path / "empty"], "empty holds no point cloud"),
        ([tmp_path / "nowhere"], "does not exist"),
        ([], "no survey was given"),
    ):
        with pytest.raises(BadInputError, match=says):
            find_surveys(typed)


def test_an_ept_is_refused_with_what_makes_one_file_of_it(tmp_path):
    ept = tmp_path / "site" / "ept.json"
    (ept.parent / "ept-data").mkdir(parents=True)
    for path in (ept, ept.parent / "ept-data" / "0-0-0-0.laz"):
        path.write_bytes(b"{}")
    for place in (ept, ept.parent, tmp_path):
        with pytest.raises(BadInputError, match=re.escape(f"pdal translate --reader readers.ept {ept} OUT.copc.laz")):
            [open_survey(path) for path in find_surveys([place])]


# ---- a file that does not stay the same while it is read: no mixture comes of it, and no word of damage ----

POINTS = np.round(np.random.default_rng(1).uniform(0, 50, (3000, 3)), 3) + np.array([500_000.0, 4_000_000.0, 0.0])


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "packed pcd"])
def test_a_survey_that_is_written_again_or_goes_away_between_two_chunks(tmp_path, kind):
    path = write_kind(kind, tmp_path, POINTS)
    chunks, before = open_survey(path).clouds(500), path.stat().st_mtime_ns
    next(chunks)
    assert write_kind(kind, tmp_path, POINTS + np.array([0.0, 0.0, 5.0])) == path
    os.utime(path, ns=(0, before + 1_000_000_000))
    with pytest.raises(BadInputError, match=rf"{path.name} changed while it was read.*Run\s+again"):
        list(chunks)
    chunks = open_survey(path).clouds(500)
    next(chunks)
    path.unlink()
    with pytest.raises(BadInputError, match="changed while it was read: it was removed"):
        list(chunks)


def test_a_change_while_the_header_is_read(tmp_path, monkeypatch):
    path = write_kind("las", tmp_path, POINTS)
    whole = path.read_bytes()

    def read_and_change(*arguments):
        path.write_bytes(whole[:200])
        return original(*arguments)

    original = las_module.read_raw_header
    monkeypatch.setattr(las_module, "read_raw_header", read_and_change)
    with pytest.raises(BadInputError, match="changed while it was read"):
        open_survey(path)
