"""Files, folders and URLs: the same survey from wherever it lies, no more bytes than needed, and no mixture of two."""

import os
import re
import sys
import threading

import numpy as np
import pytest
from range_server import serving
from survey_kinds import KINDS, write_kind

import bumpymap.readers.las as las_module
from bumpymap.core import install_command
from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.readers import find_surveys, identity, is_url, open_survey, source
from bumpymap.readers.source import read_range

PLACE = np.array([500_000, 4_000_000, 0])


def random_points(count):
    return np.round(np.random.default_rng(4).uniform(0, 100, (count, 3)), 3) + PLACE


@pytest.fixture
def memory():
    """Files by name in fsspec's memory; gone afterwards."""
    files = pytest.importorskip("fsspec").filesystem("memory")

    def put(name, data):
        files.pipe(f"/surveys/{name}", data)
        return f"memory://surveys/{name}"

    yield put
    if files.exists("/surveys"):
        files.rm("/surveys", recursive=True)


@pytest.fixture
def server(tmp_path):
    """A folder on the web: its address, and the handler that counts."""
    pytest.importorskip("aiohttp")
    with serving(tmp_path) as found:
        yield found


@pytest.mark.parametrize("kind", KINDS)
def test_a_url_gives_the_points_of_the_file(tmp_path, read, memory, kind):
    path = write_kind(kind, tmp_path, random_points(50))
    for where in (memory(path.name, path.read_bytes()), path.as_uri()):
        reader = open_survey(where)
        assert all(np.array_equal(a, b) for a, b in zip(read(reader, 7), read(open_survey(path), 7), strict=True))
        assert reader.info.path == where
        assert reader.info.size_bytes == path.stat().st_size


def test_points_come_from_the_web_by_ranges(las, read, server):
    address, handler = server
    points = random_points(60_000)
    path = las.pack(las.write(points=points, version="1.4", fmt=6), 5000)
    reader = open_survey(f"{address}/{path.name}")
    opened = handler.sent
    chunk = reader.chunks(5000)[7]
    got = reader.convert(chunk, reader.fetch(chunk)).cloud.easting
    assert handler.sent - opened < path.stat().st_size / 10
    assert np.array_equal(got, points[chunk.first : chunk.first + chunk.points, 0])
    assert np.array_equal(read(reader)[0], points)


def test_a_file_on_a_server_that_is_written_again_while_it_is_read(las, server):
    """Told by the headers of each answer: by ETag, by the time of change, by the size."""
    address, handler = server
    for key, before, after in [("ETag", '"1"', '"2"'), ("Last-Modified", "monday", "tuesday"), (None, "", "")]:
        path = las.pack(las.write(points=random_points(20_000), version="1.4", fmt=6), 1000)
        handler.headers_beside = {key: before} if key else {}
        chunks, behind = (open_survey(f"{address}/{path.name}").clouds(size) for size in (1000, 100_000))
        next(chunks)
        next(behind)
        handler.headers_beside = {key: after} if key else {}
        if key is None:
            path.write_bytes(path.read_bytes() + bytes(10))
        with pytest.raises(BadInputError, match=rf"{path.name} changed while it was read"):
            next(chunks)
        if key == "ETag":  # a change behind the last range is told at the end
            with pytest.raises(BadInputError, match="the server reports version etag"):
                next(behind)


def test_servers_that_give_other_bytes_or_no_ranges(las, server):
    address, handler = server
    path = las.write()
    handler.shift = 5
    with pytest.raises(BadInputError, match="returned byte 105 instead of byte 100"):
        read_range(f"{address}/{path.name}", 100, 50)
    # A large file is refused at the first answer, of which no more is read than what the system had taken in by then.
    handler.whole_files_alone = True
    os.truncate(path, 200_000_000)
    with pytest.raises(BadInputError, match="does not support range requests"):
        open_survey(f"{address}/{path.name}")
    assert handler.sent < 50_000_000


def test_a_server_that_stalls(las, server, monkeypatch):
    address, handler = server
    path = las.write()
    reader = open_survey(f"{address}/{path.name}")
    monkeypatch.setattr(source, "STALL_S", 0.2)
    handler.stalled = threading.Event()
    try:
        with pytest.raises(BadInputError, match=r"^the server of .*a\.las sent nothing for 0\.2 s"):
            list(reader.clouds())
        assert handler.requests == 1
        with pytest.raises(BadInputError, match="sent nothing"):
            open_survey(f"{address}/{path.name}")
    finally:
        handler.stalled.set()


def test_what_is_not_there(memory, tmp_path, monkeypatch):
    memory("a.laz", b"x")
    for where in ("memory://surveys/b.laz", (tmp_path / "b.laz").as_uri(), tmp_path / "b.laz", tmp_path):
        with pytest.raises(BadInputError, match=rf"cannot read .*(b\.laz|{tmp_path.name})"):
            open_survey(where)
    with pytest.raises(BadInputError, match="is empty"):
        open_survey(memory("c.laz", b""))
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.laz")
        with pytest.raises(BadInputError, match="a pipe or a device"):  # which is not waited for
            open_survey(tmp_path / "pipe.laz")
    with pytest.raises(UsageError, match="nowhere://a"):
        open_survey("nowhere://a.laz")
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(UsageError, match=re.escape(install_command("remote"))):
        open_survey("s3://bucket/a.laz")


def test_identity_tells_files_and_versions_apart(tmp_path, memory):
    path, data = tmp_path / "a", bytearray(200_000)
    path.write_bytes(data)
    first = identity(path)
    assert first == identity(path)
    assert first["size"] == 200_000
    os.utime(path, ns=(5, 5))
    touched = identity(path)
    assert touched != first
    assert touched["digest"] == first["digest"]
    url = memory("a", bytes(data))
    assert identity(url)["digest"] == first["digest"]
    assert identity(url) == identity(url)
    for place in (0, 199_999):
        path.write_bytes(data[:place] + b"\1" + data[place + 1 :])
        os.utime(path, ns=(5, 5))
        assert identity(path)["digest"] != first["digest"]


# ---- finding surveys ----


def test_folders_and_urls_are_searched_with_their_subfolders_and_each_file_counts_once(tmp_path, memory, server):
    files = ("b.LAZ", "a.las", "c.copc.laz", "sub/d.Ply", "sub/deep/e.pcd", "notes.txt", ".hidden.las", ".git/f.las")
    for name in (*files, "empty/notes.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
        memory(name, b"x")

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
    urls = find_surveys(["memory://surveys"])
    assert all(is_url(url) for url in urls)
    assert [str(url).partition("surveys/")[2] for url in urls] == sorted(files[:5])
    # Not asked whether it is a folder: a server would be asked for nothing.
    named, path = f"{server[0]}/notes.txt", tmp_path / "a.las"
    assert find_surveys([named, path, "s3://bucket/x.copc.laz", named]) == [path, named, "s3://bucket/x.copc.laz"]
    assert server[1].sent == 0
    for typed, says in (
        ([tmp_path / "a.las", tmp_path / "empty"], "empty holds no point cloud"),
        (["memory://surveys/empty"], "holds no point cloud"),
        ([tmp_path / "nowhere"], "does not exist"),
        ([], "no survey was given"),
    ):
        with pytest.raises(BadInputError, match=says):
            find_surveys(typed)


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
