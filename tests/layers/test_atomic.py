import os
import resource
from contextlib import contextmanager, nullcontext
from itertools import count
from pathlib import Path

import pytest
from region_files import regions_of, write_flatgeobuf, write_geojson

from bumpymap.core.errors import OutputError
from bumpymap.core.files import atomic, write_together
from bumpymap.core.types import CostTable
from bumpymap.layers.geotiff import write_raster
from bumpymap.layers.products import MapFile
from bumpymap.layers.tile_table import write_tiles


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
    **{
        Path(file).name: lambda cost_map, path, file=file: write_raster(file, CostTable.of(cost_map), path)
        for file in (MapFile.ROUGHNESS, MapFile.CLASS, MapFile.HEIGHTMAP, MapFile.RELIEF)
    },
    "tiles.parquet": lambda cost_map, path: write_tiles(CostTable.of(cost_map), path),
    "cost.geojson": lambda cost_map, path: write_geojson(regions_of(cost_map), path, local=False),
    "cost.fgb": lambda cost_map, path: write_flatgeobuf(regions_of(cost_map), path),
}


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="file size limits are a POSIX thing")
@pytest.mark.parametrize("missing", ["half", "1 byte"])
@pytest.mark.parametrize("small", [True, False])
@pytest.mark.parametrize("product", WRITERS)
def test_full_disk_is_an_error_and_leaves_nothing(tmp_path, make_field, monkeypatch, product, missing, small):
    if not small:  # what large layers do
        monkeypatch.setattr("bumpymap.layers.vector.IN_MEMORY", 0)
        monkeypatch.setattr("bumpymap.layers._cog.SMALL", 0)
    cost_map, path = make_field(20, 15), tmp_path / product
    WRITERS[product](cost_map, path)
    whole = path.stat().st_size
    for file in tmp_path.iterdir():
        file.unlink()
    size = whole // 2 if missing == "half" else whole - 1
    with pytest.raises(OutputError, match="cannot write"), largest_file(size):
        WRITERS[product](cost_map, path)
    assert names(tmp_path) == []


MINE = {"notes.txt": "mine", "in/notes.txt": "mine"}
OLD = MINE | {"a.tif": "old a", "a.tif.aux.xml": "old side", "b.tif": "old b", "run.json": "old run"}
OLD |= {"in/a.tif": "old a", "in/gone.tif": "old", "in/gone.tif.aux.xml": "old side"}
NEW = {"a.tif": "new a", "b.tif": "new b", "b.tif.aux.xml": "new side", "c.tif": "new c", "run.json": "new run"}
NEW |= {"in/a.tif": "new a", "in/c.tif": "new c"}
EARLIER = ("a.tif", "in/a.tif", "in/c.tif", "in/gone.tif")


def content(folder):
    return {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*") if path.is_file()}


def write_all(folder, files):
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)


def test_files_appear_together_and_the_last_one_last(tmp_path, monkeypatch):
    write_all(tmp_path, OLD)
    moved = []
    replace = os.replace

    def move(source, target, **folders):
        moved.append((source, target))
        replace(source, target, **folders)

    monkeypatch.setattr("os.replace", move)
    with write_together(tmp_path, "run.json", EARLIER) as staged:
        write_all(staged, NEW)
        assert {name: (tmp_path / name).read_text() for name in OLD} == OLD
    assert content(tmp_path) == MINE | NEW
    assert moved[0][0] == moved[-1][1] == "run.json"


@pytest.mark.parametrize("new", [NEW, {}])
def test_a_link_in_place_of_a_folder_is_not_followed(tmp_path, new):
    """Neither to write files there, nor to remove those of an earlier run."""
    out, mine = tmp_path / "out", tmp_path / "mine"
    write_all(tmp_path, {"mine/a.tif": "mine", "out/run.json": "old run"})
    (out / "in").symlink_to(mine)
    with pytest.raises(OutputError, match="Nothing was replaced"), write_together(out, "run.json", EARLIER) as staged:
        write_all(staged, new)
    assert content(mine) == {"a.tif": "mine"}
    assert (out / "run.json").read_text() == "old run"
    assert (out / "in").readlink() == mine


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_move_that_fails_brings_the_old_files_back(tmp_path, monkeypatch, error):
    write_all(tmp_path, OLD)
    replace, moves = os.replace, len(OLD) - len(MINE) + len(NEW)
    for number in range(moves + 1):

        def move(source, target, number=number, calls=count(), **folders):  # noqa: B008 (one for each number)
            if next(calls) == number:
                raise error
            replace(source, target, **folders)

        monkeypatch.setattr("os.replace", move)
        caught = pytest.raises((OutputError, KeyboardInterrupt), match=r"^$|Nothing was replaced")
        with caught if number < moves else nullcontext(), write_together(tmp_path, "run.json", EARLIER) as staged:
            write_all(staged, NEW)
        assert content(tmp_path) == (OLD if number < moves else MINE | NEW)
