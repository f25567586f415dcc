import os
import resource
from contextlib import contextmanager

import pytest

from bumpymap.atomic import atomic
from bumpymap.errors import OutputError
from bumpymap.products import (
    dissolve,
    write_classes,
    write_flatgeobuf,
    write_geojson,
    write_heightmap,
    write_roughness,
    write_tiles,
)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@contextmanager
def largest_file(size):
    """No file may grow beyond ``size`` bytes: what a full disk looks like to a program."""
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)


def test_file_appears_only_when_it_is_whole(tmp_path):
    target = tmp_path / "a.txt"
    with atomic(target) as temporary:
        temporary.write_text("new")
        assert not target.exists()
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".txt"
    assert target.read_text() == "new"
    assert names(tmp_path) == ["a.txt"]


def test_failure_keeps_the_old_file_and_leaves_no_scratch(tmp_path):
    target = tmp_path / "a.tif"
    target.write_text("old")

    def write_half():
        with atomic(target) as temporary:
            temporary.write_text("half")
            temporary.with_name(f"{temporary.stem}.scratch.tif").write_text("scratch")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_half()
    assert target.read_text() == "old"
    assert names(tmp_path) == ["a.tif"]


def test_failure_to_write_names_the_file_and_what_to_do(tmp_path):
    with pytest.raises(OutputError, match=r"cannot write .*a\.txt.*--out"), atomic(tmp_path / "no" / "a.txt") as path:
        path.write_text("x")
    with pytest.raises(OutputError, match="broken pipe of a library"), atomic(tmp_path / "a", (KeyError,)):
        raise KeyError("broken pipe of a library")


def test_side_file_moves_along_and_a_stale_one_goes(tmp_path):
    target, side = tmp_path / "a.tif", tmp_path / "a.tif.aux.xml"
    side.write_text("statistics of other pixels")
    with atomic(target) as temporary:
        temporary.write_text("1")
    assert names(tmp_path) == ["a.tif"]
    with atomic(target) as temporary:
        temporary.write_text("2")
        temporary.with_name(temporary.name + ".aux.xml").write_text("categories")
    assert (target.read_text(), side.read_text()) == ("2", "categories")
    assert names(tmp_path) == ["a.tif", "a.tif.aux.xml"]


WRITERS = {
    "roughness.tif": write_roughness,
    "class.tif": write_classes,
    "heightmap.tif": write_heightmap,
    "tiles.parquet": write_tiles,
    "cost.geojson": lambda cost_map, path: write_geojson(dissolve(cost_map), path, local=False),
    "cost.fgb": lambda cost_map, path: write_flatgeobuf(dissolve(cost_map), path),
}


@pytest.mark.skipif(os.name != "posix", reason="file size limits are a POSIX thing")
@pytest.mark.parametrize("missing", ["all but 1 kB", "half", "100 bytes", "1 byte"])
@pytest.mark.parametrize("product", WRITERS)
def test_full_disk_is_an_error_and_leaves_nothing(tmp_path, make_field, product, missing):
    cost_map, path = make_field(20, 15), tmp_path / product
    WRITERS[product](cost_map, path)
    whole = path.stat().st_size
    for file in tmp_path.iterdir():
        file.unlink()
    size = {"all but 1 kB": 1000, "half": whole // 2, "100 bytes": whole - 100, "1 byte": whole - 1}[missing]
    with pytest.raises(OutputError, match="cannot write"), largest_file(size):
        WRITERS[product](cost_map, path)
    assert names(tmp_path) == []
