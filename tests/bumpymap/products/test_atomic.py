import os
import resource
from contextlib import contextmanager

import pytest

from bumpymap.errors import OutputError
from bumpymap.products import dissolve, write_flatgeobuf, write_geojson, write_heightmap, write_tiles
from bumpymap.products.atomic import atomic


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


@pytest.mark.skipif(os.name != "posix", reason="file size limits are a POSIX thing")
@pytest.mark.parametrize("size", [1_000, 60_000])
@pytest.mark.parametrize("product", ["heightmap.tif", "tiles.parquet", "cost.geojson", "cost.fgb"])
def test_full_disk_is_an_error_and_leaves_nothing(tmp_path, cost_map, product, size):
    regions, path = dissolve(cost_map), tmp_path / product
    write = {
        "heightmap.tif": lambda: write_heightmap(cost_map, path),
        "tiles.parquet": lambda: write_tiles(cost_map, path),
        "cost.geojson": lambda: write_geojson(regions, path, local=False),
        "cost.fgb": lambda: write_flatgeobuf(regions, path),
    }[product]
    with pytest.raises(OutputError, match="cannot write"), largest_file(size):
        write()
    assert names(tmp_path) == []
    write()
    assert names(tmp_path) == [product]
