"""``--skip-bad``: the good files are mapped as if the bad ones were not there, and what was skipped is written down."""

import json

import numpy as np
import pytest
from corpus import hostile_files
from corpus.bases import bases, utm
from corpus.case import patched
from corpus.las_file import cloud, las_file, layout_of
from corpus.runner import Runner

pytestmark = pytest.mark.slow

LAYERS = (
    *("rasters/roughness.tif", "rasters/class.tif", "cost.tif", "rasters/heightmap.tif"),
    *("tiles.parquet", "cost.geojson", "cost.fgb"),
)
BAD = (
    "foreign-lfs_pointer.laz",
    "foreign-empty.laz",
    "las12-scale_x-nan.las",
    "laz12-cut-chunk_3.laz",
    "laz12-chunk_3-far_point.laz",
    "las14-evlr_count-2to32.las",
    "text-count-10to12.ply",
    "pcd_packed-packed-2to32.pcd",
)


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    child = Runner(tmp_path_factory.mktemp("runner"))
    yield child
    child.close()


@pytest.fixture
def folder(tmp_path):
    """A folder with one good survey."""
    place = tmp_path / "surveys"
    place.mkdir()
    (place / "good.las").write_bytes(bases()["las12.las"])
    return place


def mapped(runner, folder, out, *options):
    return runner.run("map", folder, "--out", out, "--threads", "1", "--quiet", *options)


def layers(out):
    return {name: (out / name).read_bytes() for name in LAYERS}


def neighbour():
    """LAZ in five chunks: other points than those of the good survey, on the same tiles."""
    return las_file(np.add(cloud(400, seed=1), [0.0, 0.0, 3.0]), minor=4, fmt=7, chunks=80, vlrs=[utm()], wkt_bit=True)


def test_bad_files_of_every_kind_are_skipped_and_listed(runner, folder, tmp_path):
    assert mapped(runner, folder, tmp_path / "alone").exit == 0
    held = {case.name: case.data for case in hostile_files()}
    for name in BAD:
        (folder / name).write_bytes(held[name])
    outcome = mapped(runner, folder, tmp_path / "out", "--skip-bad")
    assert outcome.exit == 4, outcome.text
    assert layers(tmp_path / "out") == layers(tmp_path / "alone")
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert set(record["skipped"]) == {str(folder / name) for name in BAD}
    assert all(path in message for path, message in record["skipped"].items())
    assert [entry["path"] for entry in record["inputs"]] == [str(folder / "good.las")]


def test_a_file_that_breaks_in_its_middle_leaves_no_point(runner, folder, tmp_path):
    assert mapped(runner, folder, tmp_path / "alone").exit == 0
    data, other = neighbour(), folder / "other.laz"
    other.write_bytes(data)
    assert mapped(runner, folder, tmp_path / "both").exit == 0
    # Points of the other file would be seen: the layers are others with them.
    assert layers(tmp_path / "both")["tiles.parquet"] != layers(tmp_path / "alone")["tiles.parquet"]
    other.write_bytes(patched(data, layout_of(data).chunks[2][0], "i", 2**31 - 1))
    outcome = mapped(runner, folder, tmp_path / "out", "--skip-bad")
    assert outcome.exit == 4, outcome.text
    assert layers(tmp_path / "out") == layers(tmp_path / "alone")
    assert list(json.loads((tmp_path / "out" / "run.json").read_text())["skipped"]) == [str(other)]


def test_nothing_but_bad_files(runner, folder, tmp_path):
    (folder / "good.las").write_bytes(b"")
    outcome = mapped(runner, folder, tmp_path / "out", "--skip-bad")
    assert outcome.exit == 3
    assert len(outcome.errors) == 1
    assert not (tmp_path / "out").exists()
