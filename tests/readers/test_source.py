"""Files and URLs: the same survey from wherever it lies, no more bytes than needed."""

import os
import sys
import threading

import numpy as np
import pytest
from range_server import serving
from survey_kinds import KINDS, write_kind

from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.readers import find_surveys, identity, is_url, open_survey, source
from bumpymap.readers.source import read_range, size_of

fsspec = pytest.importorskip("fsspec")


@pytest.fixture
def memory():
    """Files by name in fsspec's memory; gone afterwards."""
    files = fsspec.filesystem("memory")

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
    points = np.round(np.random.default_rng(4).uniform(0, 100, (50, 3)), 3) + np.array([500_000, 4_000_000, 0])
    path = write_kind(kind, tmp_path, points)
    for where in (memory(path.name, path.read_bytes()), path.as_uri()):
        reader = open_survey(where)
        assert all(np.array_equal(a, b) for a, b in zip(read(reader, 7), read(open_survey(path), 7), strict=True))
        assert reader.info.path == where
        assert reader.info.size_bytes == path.stat().st_size


def test_points_come_from_the_web_by_ranges(las, laz, read, server):
    address, handler = server
    rng = np.random.default_rng(4)
    points = np.round(rng.uniform(0, 100, (60_000, 3)), 3) + np.array([500_000, 4_000_000, 0])
    path = laz.pack(las.write(points=points, version="1.4", fmt=6), 5000)
    reader = open_survey(f"{address}/{path.name}")
    opened = handler.sent
    chunk = reader.chunks(5000)[7]
    got = reader.convert(chunk, reader.fetch(chunk)).cloud.easting
    assert handler.sent - opened < path.stat().st_size / 10
    assert np.array_equal(got, points[chunk.first : chunk.first + chunk.points, 0])
    assert np.array_equal(read(reader)[0], points)


def test_a_file_on_a_server_that_is_written_again_while_it_is_read(las, laz, server):
    """Told by the headers of each answer: by ETag, by the time of change, by the size."""
    address, handler = server
    points = np.round(np.random.default_rng(4).uniform(0, 100, (20_000, 3)), 3) + np.array([500_000, 4_000_000, 0])
    for key, before, after in [("ETag", '"1"', '"2"'), ("Last-Modified", "monday", "tuesday"), (None, "", "")]:
        path = laz.pack(las.write(points=points, version="1.4", fmt=6), 1000)
        handler.headers_beside = {key: before} if key else {}
        chunks = open_survey(f"{address}/{path.name}").clouds(1000)
        next(chunks)
        handler.headers_beside = {key: after} if key else {}
        if key is None:
            path.write_bytes(path.read_bytes() + bytes(10))
        with pytest.raises(BadInputError, match=rf"{path.name} changed while it was read"):
            next(chunks)


def test_a_change_behind_the_last_range_is_told_at_the_end(las, server):
    address, handler = server
    path = las.write()
    handler.headers_beside = {"ETag": '"1"'}
    chunks = open_survey(f"{address}/{path.name}").clouds()
    next(chunks)
    handler.headers_beside = {"ETag": '"2"'}
    with pytest.raises(BadInputError, match="the server reports version etag"):
        next(chunks)


def test_a_large_file_on_a_server_without_ranges_is_not_fetched(las, server):
    """It is refused at its first answer, of which no more is read than what the system had taken in by then."""
    address, handler = server
    handler.whole_files_alone = True
    path = las.write()
    with path.open("ab") as file:
        file.truncate(200_000_000)
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


def test_a_server_that_gives_other_bytes(las, server):
    address, handler = server
    path = las.write()
    handler.shift = 5
    with pytest.raises(BadInputError, match="returned byte 105 instead of byte 100"):
        read_range(f"{address}/{path.name}", 100, 50)


def test_a_url_of_a_web_server_is_a_file_whatever_its_name(server, tmp_path):
    address, handler = server
    (tmp_path / "survey").write_bytes(bytes(1_000_000))
    assert find_surveys([f"{address}/survey"]) == [f"{address}/survey"]
    assert handler.sent == 0


@pytest.mark.parametrize("remote", [False, True])
def test_ranges_end_where_the_file_does(tmp_path, memory, remote):
    path = tmp_path / "a"
    path.write_bytes(bytes(range(100)))
    where = memory("a", path.read_bytes()) if remote else path
    assert read_range(where, 10, 5).tolist() == [10, 11, 12, 13, 14]
    assert read_range(where, 95, 50).tolist() == [95, 96, 97, 98, 99]
    assert read_range(where, 200, 50).tolist() == []
    assert size_of(where) == 100


def test_what_is_not_there(memory, tmp_path):
    memory("a.laz", b"x")
    for where in ("memory://surveys/b.laz", (tmp_path / "b.laz").as_uri(), tmp_path / "b.laz"):
        with pytest.raises(BadInputError, match=r"cannot read .*b\.laz"):
            open_survey(where)
    with pytest.raises(BadInputError, match="is empty"):
        open_survey(memory("c.laz", b""))


def test_urls_that_need_more_than_is_there(monkeypatch):
    with pytest.raises(UsageError, match="nowhere://a"):
        open_survey("nowhere://a.laz")
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(UsageError, match=r"pip install 'bumpymap\[remote\]'"):
        open_survey("s3://bucket/a.laz")


def test_folders_of_urls(memory, tmp_path):
    for name in ("b.LAZ", "sub/a.las", "sub/notes.txt", ".git/c.las", "sub/.d.las", "named.bin"):
        memory(name, b"x")
    found = find_surveys(["memory://surveys"])
    assert [str(url).removeprefix("memory://").lstrip("/") for url in found] == ["surveys/b.LAZ", "surveys/sub/a.las"]
    assert all(is_url(url) for url in found)
    named = memory("named.bin", b"x")
    path = tmp_path / "z.las"
    path.write_bytes(b"x")
    # Not asked whether it is a folder: a server would be asked for nothing.
    assert find_surveys([named, path, "s3://bucket/x.copc.laz", named]) == [path, named, "s3://bucket/x.copc.laz"]
    memory("empty/notes.txt", b"x")
    with pytest.raises(BadInputError, match="holds no point cloud"):
        find_surveys(["memory://surveys/empty"])


def test_paths_as_text_are_paths(tmp_path):
    (tmp_path / "a.las").write_bytes(b"x")
    assert find_surveys([str(tmp_path)]) == [tmp_path / "a.las"]


def test_identity_tells_files_and_versions_apart(tmp_path, memory):
    path = tmp_path / "a"
    path.write_bytes(bytes(200_000))
    first = identity(path)
    assert first == identity(path)
    assert first["size"] == 200_000
    os.utime(path, ns=(5, 5))
    touched = identity(path)
    assert touched != first
    assert touched["digest"] == first["digest"]
    for place in (0, 199_999):
        data = bytearray(200_000)
        data[place] = 1
        path.write_bytes(data)
        os.utime(path, ns=(5, 5))
        assert identity(path)["digest"] != first["digest"]
    url = memory("a", bytes(200_000))
    assert identity(url)["digest"] == first["digest"]
    assert identity(url) == identity(url)
    assert identity(memory("b", bytes(10)))["size"] == 10


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.laz")
    with pytest.raises(BadInputError, match="a pipe or a device"):
        open_survey(tmp_path / "a.laz")
