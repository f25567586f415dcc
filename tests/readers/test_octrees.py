"""COPC and EPT: octrees read region by region, in one file or as a folder, and octrees that lie."""

import json
import os
import re

import las_files
import numpy as np
import pytest
from epts import write_ept
from pyproj import CRS
from range_server import serving

from bumpymap.core.errors import BadInputError
from bumpymap.readers import PointStats, ReadOptions, ept, find_surveys, hash_survey, identity, open_survey
from bumpymap.readers.las import LasSurvey

INFO = 375 + 54
"""Byte of the COPC record: middle x, y, z, half side, spacing, page place and size, ..."""
US_FOOT = 1200 / 3937


MADE = {}
"""Bytes of the files that were made already: many chunks take their time."""


@pytest.fixture
def tree(las):
    """An octree of 4,000 points on 400 x 400 units, 5 levels."""

    def write(epsg=None, page_levels=None):
        path = las.folder / "t.copc.laz"
        if (epsg, page_levels) not in MADE:
            plain = las.write("t.las", points(), version="1.4", fmt=7, epsg=epsg)
            MADE[epsg, page_levels] = las.octree(plain, levels=4, page_levels=page_levels).read_bytes()
        path.write_bytes(MADE[epsg, page_levels])
        return path

    return write


def points():
    rng = np.random.default_rng(9)
    return np.round(rng.uniform([5e5, 4e6, 0], [500_400, 4_000_400, 40], (4000, 3)), 3)


def check_boxes(chunks, found):
    for chunk, batch in zip(chunks, found, strict=True):
        box, cloud = chunk.bounds, batch.cloud
        assert cloud.easting.size == chunk.points
        assert box.west <= cloud.easting.min() <= cloud.easting.max() <= box.east
        assert box.south <= cloud.northing.min() <= cloud.northing.max() <= box.north


@pytest.mark.slow
@pytest.mark.parametrize(("page_levels", "size"), [(None, 1), (1, 300), (3, 100_000)])
def test_chunks_hold_all_points_each_inside_its_box(tree, batches, table, size, page_levels):
    path = tree(epsg=2276, page_levels=page_levels)
    reader = open_survey(path)
    assert reader.info.format == "COPC (LAZ 1.4, point format 7)"
    chunks = reader.chunks(size)
    found = batches(reader, size)
    check_boxes(chunks, found)
    assert np.array_equal(in_order(table(found)[:, :3]), in_order(points() * US_FOOT))


def test_an_octree_built_around_another_place(las, tree, read):
    """Regions would be taken for complete while their points are still to come."""
    path = las.patch(tree(), INFO, "<d", 500_300.0)
    with pytest.raises(BadInputError, match=r"points of .* lie outside the octree node.*`trust_points=True`"):
        list(open_survey(path).clouds())
    trusted = open_survey(path, ReadOptions(trust_points=True))
    assert {chunk.bounds for chunk in trusted.chunks(300)} == {None}
    assert len(read(trusted)[0]) == 4000


@pytest.mark.slow
def test_points_outside_their_node_are_as_many_however_the_file_is_cut(las, tree):
    """Counted one by one: a point is in the cube of its node, 1 m around it allowed."""
    reader = LasSurvey(las.patch(tree(epsg=32614), INFO, "<d", 500_202.0), ReadOptions())

    def inside(place, box):
        low, high = np.array([box.west, box.south]) - 1, np.array([box.east, box.north]) + 1
        return ((place >= low) & (place <= high)).all(axis=1)

    expected = 0
    for chunk in reader.chunks(1):
        words = reader.fetch(chunk).view(np.uint8)[:, :8].copy().view("<i4")
        place = words * 0.001 + np.array([500_000.0, 4_000_000.0])
        expected += int((inside(place, reader.info.bounds) & ~inside(place, chunk.bounds)).sum())
    assert expected > 0
    for size in (300, 1500, 100_000):
        total = PointStats()
        for chunk in reader.chunks(size):
            batch = reader.convert(chunk, reader.fetch(chunk))
            assert batch.cloud.easting.size == (0 if batch.stats.points_outside_node else chunk.points)
            total = total.merge(batch.stats)
        assert total.points_outside_node == expected


# ---- EPT: the same points as one LAZ file, from a folder or a server, and folders that lie ----

POINTS = np.round(np.random.default_rng(3).uniform([5e5, 4e6, 0], [500_040, 4_000_040, 12], (3000, 3)), 3)
ROOT = "ept-data/0-0-0-0.laz"


@pytest.fixture
def made(las):
    """Writes an EPT of the points, into a new folder or the one of that name; gives the path of ept.json."""
    plain = las.write("plain.las", POINTS, version="1.4", fmt=6, epsg=32614, classification=np.arange(3000) % 6)

    def write(name="site", **how):
        return write_ept(las.folder / name, plain, **{"levels": 1} | how)

    return write


def in_order(points):
    return points[np.lexsort(points.T)]


def sorted_points(reader, size=1_000_000):
    clouds = reader.clouds(size)
    return in_order(np.concatenate([np.column_stack([c.easting, c.northing, c.upward, c.kind]) for c in clouds]))


@pytest.mark.parametrize("how", [{}, {"split": 1}, {"levels": 3, "split": 2, "offsets": True}], ids=str)
def test_the_points_of_an_ept_are_those_of_the_file_bit_for_bit(made, las, how):
    path = made(**how)
    reader, plain = open_survey(path), open_survey(las.folder / "plain.las")
    nodes = list((las.folder / "site/ept-data").iterdir())
    assert reader.info.format.startswith(f"EPT of {len(nodes)} nodes (LAZ 1.4, ")
    assert (reader.info.point_count, reader.info.georeference) == (3000, plain.info.georeference)
    wanted = sorted_points(plain)
    assert np.array_equal(sorted_points(reader), wanted)
    assert np.array_equal(sorted_points(open_survey(path), 100), wanted)


def test_nodes_come_depth_first_and_say_where_they_lie(made, batches):
    reader = open_survey(made(levels=2))
    sides = [chunk.bounds.east - chunk.bounds.west for chunk in reader.chunks(1)]
    assert [round(side / sides[0], 3) for side in sides[:3]] == [1.0, 0.5, 0.25]
    check_boxes(reader.chunks(1), batches(reader, 1))


def test_a_folder_of_surveys_holds_an_ept_as_one(made, las):
    path = made("surveys/site")
    beside = las.write("surveys/more.las")
    (las.folder / "surveys/site/ept-sources").mkdir()
    assert find_surveys([las.folder / "surveys"]) == [beside, path]
    assert find_surveys([path.parent, path]) == [path]


def test_an_ept_in_a_folder_of_an_object_store(made):
    fsspec, path = pytest.importorskip("fsspec"), made(split=1)
    store = fsspec.filesystem("memory")
    store.put(str(path.parent), "/epts/site", recursive=True)
    try:
        (url,) = find_surveys(["memory://epts"])
        assert np.array_equal(sorted_points(open_survey(url)), sorted_points(open_survey(path)))
        assert identity(url)["size"] == identity(path)["size"]
    finally:
        store.rm("/epts", recursive=True)


def test_an_ept_by_url_gives_the_same_points_and_asks_for_nothing_else(made, las):
    pytest.importorskip("aiohttp")
    path, asked = made(split=1, offsets=True), []
    with serving(las.folder) as (address, handler):
        handler.headers_beside, original = {"ETag": '"1"'}, handler.do_GET
        handler.do_GET = lambda self: (asked.append(self.path), original(self))
        url = f"{address}/site/ept.json?key=word"
        reader = open_survey(url)
        assert np.array_equal(sorted_points(reader, 300), sorted_points(open_survey(path)))
        files = {f"/site/{file.relative_to(path.parent).as_posix()}?key=word" for file in path.parent.rglob("*.*")}
        assert set(asked) == files
        assert find_surveys([url]) == [url]
        assert identity(url) == identity(url)
        handler.headers_beside = {"ETag": '"2"'}
        with pytest.raises(BadInputError, match=r"0-0-0-0\.laz\?key=word changed while it was read"):
            list(reader.clouds())
        (path.parent / ROOT).unlink()
        with pytest.raises(BadInputError, match=r"cannot read .*0-0-0-0\.laz\?key=word: there is no such file|404"):
            open_survey(url)


@pytest.mark.parametrize("name", ["ept.json", "ept-hierarchy/1-0-0-0.json", ROOT])
def test_a_change_of_any_file_is_noticed(made, name):
    path = made(split=1)
    before, reader = identity(path), open_survey(path)
    file = path.parent / name
    os.utime(file, ns=(0, file.stat().st_mtime_ns + 1_000_000_000))
    after = identity(path)
    assert before["version"] != after["version"]
    assert (before["size"], before["digest"]) == (after["size"], after["digest"])
    with pytest.raises(BadInputError, match=rf"{name.split('/')[-1]} changed while it was read"):
        list(reader.clouds())


@pytest.mark.parametrize("size", [100, 1000, 100_000])
def test_the_checksum_is_that_of_all_files_one_after_the_other(made, size, las):
    path = made(split=1)
    reader = open_survey(path, ReadOptions(checksum=True))
    list(reader.clouds(size))
    files = ept.EptFiles.find(path).places
    joined = las.folder / "joined"
    joined.write_bytes(b"".join(file.read_bytes() for file in files))
    assert sorted(files) == sorted(path.parent.rglob("*.*"))
    assert reader.checksum == hash_survey(path) == hash_survey(joined)


WKT, OTHER_WKT = (CRS(f"EPSG:{code}").to_wkt() for code in (32614, 32613))


@pytest.mark.parametrize(
    ("srs", "code", "note"),
    [
        ({"wkt": OTHER_WKT}, 32613, "its ept.json .* is used; its nodes .* differs"),
        ({"authority": "EPSG", "horizontal": "32614"}, 32614, ""),
        ({"authority": "EPSG", "horizontal": "32614", "vertical": "5703", "wkt": WKT}, 32614, ""),
        ({"wkt": "nonsense"}, 32614, ""),
        ({}, 32614, ""),
    ],
)
def test_the_crs_is_that_of_ept_json_or_else_of_the_nodes(made, srs, code, note):
    info = open_survey(made(srs=srs)).info
    crs = info.georeference.crs
    assert (crs.sub_crs_list[0] if crs.is_compound else crs).to_epsg() == code
    assert crs.is_compound == ("vertical" in srs)
    assert re.search(note, " ".join(info.notes))


def listed(folder, file="0-0-0-0", **changed):
    """Change a file of a hierarchy, or begin it: values by key, with _ for -; None leaves one out."""
    path = folder / f"ept-hierarchy/{file}.json"
    entries = json.loads(path.read_text()) if path.exists() else {}
    entries |= {key.strip("_").replace("_", "-"): n for key, n in changed.items()}
    path.write_text(json.dumps({key: n for key, n in entries.items() if n is not None}))


def head(folder, **changed):
    path = folder / "ept.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))


def linked(folder, name):
    """A file or a folder of the EPT lies elsewhere, behind a link."""
    (folder / name).rename(folder.parent / "elsewhere")
    (folder / name).symlink_to(folder.parent / "elsewhere")


def spoilt(folder, at, data):
    """Other bytes in a node, from a place on that counts from the start, or if negative from the end."""
    whole = bytearray((folder / ROOT).read_bytes())
    at %= len(whole)
    whole[at : at + len(data)] = data
    (folder / ROOT).write_bytes(whole)


def of_other_points(folder, east=0.0, **how):
    """A node has points in another format, at another scale, or elsewhere."""
    points = POINTS[:500] + np.array([east, 0.0, 0.0])
    how = {"version": "1.4", "fmt": 6, "compress": True, "records": [las_files.geokeys({1024: 1, 3072: 32614})]} | how
    (folder / "ept-data/1-0-0-0.laz").write_bytes(las_files.las_bytes(points, **how))
    listed(folder, _1_0_0_0=500)


HOSTILE = {
    "binary": (lambda f: head(f, dataType="binary"), "the dataType of .* is 'binary'; 'laszip' is read. Write it as"),
    "gzip": (lambda f: head(f, hierarchyType="gzip"), "the hierarchyType of .* is 'gzip'"),
    "no JSON": (lambda f: (f / "ept.json").write_text('{"bounds": [0,'), "cannot read the JSON of .*ept.json"),
    "nested": (lambda f: (f / "ept.json").write_text("[" * 100_000), "nested more than 50 deep"),
    "too long": (lambda f: os.truncate(f / "ept.json", 1 << 30), "has 1,073,741,824 bytes; at most"),
    "no bounds": (lambda f: head(f, bounds=[1, 2]), "ept.json is not a file of an EPT: bounds is"),
    "wide": (lambda f: head(f, bounds=[0, 0, 0, float("inf"), 1, 1]), "not a file of an EPT: bounds"),
    "inverted": (lambda f: head(f, boundsConforming=[9, 9, 9, 0, 0, 0]), "impossible extent"),
    "key outside": (lambda f: listed(f, _1_2_0_0=5), "gives '1-2-0-0' 5 points"),
    "key that is a path": (lambda f: listed(f, **{"../../secret": 5}), r"gives '../../secret' 5 points"),
    "key in two spellings": (lambda f: listed(f, _1_00_0_0=5), "gives '1-00-0-0' 5 points"),
    "deep key": (lambda f: listed(f, _31_0_0_0=5), "gives '31-0-0-0' 5 points"),
    "text for a number": (lambda f: listed(f, _0_0_0_0="many"), "0-0-0-0.json is not a file of an EPT"),
    "no hierarchy": (lambda f: (f / "ept-hierarchy/0-0-0-0.json").unlink(), "cannot read .*0-0-0-0.json"),
    "cycle": (lambda f: listed(f, _0_0_0_0=-1), "gives '0-0-0-0' -1 points"),
    "file of another node": (
        lambda f: (listed(f, _1_0_0_0=-1), listed(f, "1-0-0-0", _1_1_0_0=-1)),
        "1-0-0-0.json gives '1-1-0-0' -1 points",
    ),
    "listed twice": (
        lambda f: (listed(f, _1_0_0_0=-1, _2_0_0_0=9), listed(f, "1-0-0-0", _2_0_0_0=9)),
        "lists 2-0-0-0 twice",
    ),
    "no points": (lambda f: (f / "ept-hierarchy/0-0-0-0.json").write_text("{}"), "holds no points"),
    "no node": (lambda f: (f / ROOT).unlink(), "cannot read .*0-0-0-0.laz: No such file"),
    "more than a node can hold": (lambda f: listed(f, _1_0_0_0=(1 << 31) - 1), "impossible"),
    "fewer than a node holds": (lambda f: listed(f, _1_0_0_0=1), "the hierarchy of its EPT says"),
    "node of an endless file": (lambda f: os.truncate(f / ROOT, 1 << 40), "too many for its"),
    "no LAZ": (lambda f: (f / "ept-data/1-0-0-0.laz").write_bytes(bytes(5000)), "1-0-0-0.laz is LAS 0.0"),
    "cut off": (lambda f: os.truncate(f / ROOT, 900), "0-0-0-0.laz"),
    "damaged points": (lambda f: spoilt(f, -2000, bytes(1500)), "0-0-0-0.laz"),
    "another format": (lambda f: of_other_points(f, fmt=7), "1-0-0-0.laz are not stored as those of .*0-0-0-0.laz"),
    "another scale": (lambda f: of_other_points(f, scale=0.01), "are not stored as those of"),
    "another grid": (lambda f: of_other_points(f, offset=(5e5 + 0.0005, 4e6, 0.0)), "are not stored as those of"),
    "beyond the grid": (lambda f: of_other_points(f, 2.3e6, offset=(2.8e6, 4e6, 0.0)), "lies too far from"),
    "in another place": (of_other_points, "lie outside the octree node"),
    "more nodes than are read": (lambda f: listed(f, _5_0_0_0=0), "lists more than 5 nodes"),
    "linked node": (lambda f: linked(f, ROOT), "0-0-0-0.laz is a link out of .*site, which is not followed"),
    "linked hierarchy": (lambda f: linked(f, "ept-hierarchy/0-0-0-0.json"), "is a link out of"),
    "linked folder": (lambda f: linked(f, "ept-data"), "is a link out of"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_folders_that_lie_are_refused_with_their_file(made, monkeypatch, name):
    path = made()
    spoil, message = HOSTILE[name]
    spoil(path.parent)
    if name == "more nodes than are read":
        monkeypatch.setattr(ept, "MOST_NODES", 5)
    with pytest.raises(BadInputError, match=message):
        list(open_survey(path).clouds())


def test_links_inside_the_folder_nodes_without_points_and_another_count_in_ept_json_are_no_fault(made):
    path = made(points=3001)
    folder = path.parent
    (folder / ROOT).rename(folder / "root.laz")
    (folder / ROOT).symlink_to(folder / "root.laz")
    listed(folder, _5_0_0_0=0)
    reader = open_survey(path)
    assert len(sorted_points(reader)) == 3000
    assert reader.info.notes == ("its ept.json counts 3,001 points, and its hierarchy 3,000, which are read",)
