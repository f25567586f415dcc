"""A map in sheets is the same map: pixel for pixel, row for row, way for way."""

import csv
import json
import shutil
from xml.etree import ElementTree as ET

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import rasterio
from cost_maps import make_field, make_map, part_of
from route_maps import RUN, copy_folder
from route_sites import place, site
from sheet_maps import SMALL, write_in_sheets as write

import bumpymap
from bumpymap.core.errors import BadInputError, OutputError
from bumpymap.core.types import CostTable, Reason
from bumpymap.layers import open_map, sheets as writing, write_products
from bumpymap.layers.products import PRODUCT_NAMES, VIEW_NAMES
from bumpymap.layers.sheet_paths import sheet_folders
from bumpymap.views import write_map_views
from bumpytiles import BLOCK_TILES

RASTERS = ("roughness", "class", "reason", "cost", "barred", "heightmap", "relief", "obstacle", "passage")
VIEWS = sorted({*VIEW_NAMES, "catalog.json"} - {"tiles.qml"})


def names_in(folder):
    return sorted(path.name for path in (folder / "sheets").iterdir())


def rows_of(folders):
    table = pa.concat_tables([pq.read_table(folder / "tiles.parquet") for folder in folders])
    return table.sort_by([("row", "ascending"), ("col", "ascending")])


@pytest.mark.parametrize("name", RASTERS)
def test_a_virtual_raster_shows_what_one_raster_would(name, whole, sheets):
    with rasterio.open(whole / f"{name}.tif") as one, rasterio.open(sheets / f"{name}.vrt") as several:
        pixels = one.read()
        assert np.array_equal(several.read(), pixels, equal_nan=pixels.dtype.kind == "f")
        for fact in ("shape", "transform", "crs", "descriptions", "units", "dtypes", "colorinterp"):
            assert getattr(several, fact) == getattr(one, fact), fact
        np.testing.assert_array_equal(several.nodatavals, one.nodatavals)
        assert several.tags() == one.tags()
        for band in one.indexes:
            assert several.tags(band).get("long_name") == one.tags(band).get("long_name")
        if one.colorinterp[0].name == "palette":
            named, colours = categories(sheets / f"{name}.vrt"), one.colormap(1)
            assert several.colormap(1) == {code: colours[code] for code in range(len(named))}


def categories(path):
    """Names of the values of the first band."""
    band = ET.parse(path).getroot().find("VRTRasterBand")  # noqa: S314 (ours)
    return [element.text for element in band.iter("Category")]


def test_no_tile_is_lost_or_written_twice(whole, sheets):
    found, expected = rows_of(sheet_folders(sheets)), rows_of([whole])
    assert found.column_names == expected.column_names
    for name in expected.column_names:
        one, other = (table[name].combine_chunks() for table in (expected, found))
        assert repr(one.to_pylist()) == repr(other.to_pylist()), name


def test_sheets_lie_on_the_shared_grid(sheets, tmp_path):
    """Sheets of two surveys that overlap have the same names and edges, also west and south of the origin."""
    assert names_in(sheets) == ["e000000_n000000", "e000000_s000001", "w000001_n000000", "w000001_s000001"]
    write(make_field(20, 10, grid=SMALL, west=3, south=-4), tmp_path / "later", blocks=4)
    assert set(names_in(tmp_path / "later")) < set(names_in(sheets))
    for sheet in sheet_folders(sheets):
        found = pq.read_table(sheet / "tiles.parquet", columns=["col", "row"]).to_pandas() // (4 * BLOCK_TILES)
        (col,), (row,) = found["col"].unique(), found["row"].unique()
        assert sheet.name == f"{'we'[int(col >= 0)]}{abs(col):06d}_{'sn'[int(row >= 0)]}{abs(row):06d}"


def test_each_sheet_is_a_map_and_says_where_it_lies(sheets):
    record = json.loads((sheets / "run.json").read_text())
    assert record["format"] == "bumpymap-sheets"
    assert record["sheet_side_m"] == 4 * BLOCK_TILES * 3.0
    totals = {"tiles": 0, "points": 0, "passable": 0}
    for entry in record["sheets"]:
        own = bumpymap.open(sheets / entry["folder"]).manifest
        assert own["format"] == "bumpymap-run"
        assert (own["sheet"]["column"], own["sheet"]["row"]) == (entry["column"], entry["row"])
        assert own["counts"]["tiles"] == entry["tiles"]
        totals = {name: total + own["counts"][name] for name, total in totals.items()}
        west, south, east, north = entry["bounds"]
        with rasterio.open(sheets / entry["folder"] / "class.tif") as file:
            assert tuple(file.bounds) == (west, south, east, north)
    assert totals == {name: record["counts"][name] for name in totals}
    with (sheets / "sheets.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["folder"] for row in rows] == [entry["folder"] for entry in record["sheets"]]
    assert sum(int(row["tiles"]) for row in rows) == totals["tiles"]


def test_same_map_same_bytes(made, sheets, tmp_path):
    shuffled = part_of(made, np.random.default_rng(1).permutation(len(made.class_id)))
    write(shuffled, tmp_path / "again", blocks=4)
    files = [path.relative_to(sheets) for path in sorted(sheets.rglob("*")) if path.is_file()]
    of_a_sheet = len(PRODUCT_NAMES) + len(VIEW_NAMES) + 4  # sidecars
    of_the_whole = len(VIEWS) + len(RASTERS) + 2
    assert len(files) == 4 * of_a_sheet + of_the_whole
    for file in files:
        if file.name != "run.json":
            assert (sheets / file).read_bytes() == (tmp_path / "again" / file).read_bytes(), file


def test_a_map_in_sheets_can_be_moved(sheets, whole, tmp_path):
    shutil.copytree(sheets, tmp_path / "moved")
    with rasterio.open(whole / "class.tif") as one, rasterio.open(tmp_path / "moved" / "class.vrt") as several:
        assert np.array_equal(one.read(), several.read())
    assert str(sheets) not in (sheets / "class.vrt").read_text()


def test_sites_far_apart_need_no_room_between(tmp_path):
    """1,000 km apart: more than one map may span, and two sheets."""
    far = make_map([0, 333_333], [0, 333_333], [0, 1], [0, 0], grid=SMALL)
    _, summary = write(far, tmp_path, blocks=100)
    assert summary.tiles == 2
    assert len(sheet_folders(tmp_path)) == 2
    with rasterio.open(tmp_path / "class.vrt") as file:
        assert file.shape == (333_334, 333_334)
        assert file.read(1, window=((333_333, 333_334), (0, 1)))[0, 0] == 0
        assert file.read(1, window=((0, 1), (333_333, 333_334)))[0, 0] == 1
    with rasterio.open(tmp_path / "reason.vrt") as file:
        assert file.read(1, window=((0, 1), (333_333, 333_334)))[0, 0] == Reason.OK
        assert file.read(1, window=((500, 502), (500, 502))).tolist() == [[255, 255], [255, 255]]  # no points


def test_one_map_is_opened(whole, sheets):
    one, several = bumpymap.open(whole), bumpymap.open(sheets)
    assert several.sheets == sheet_folders(sheets)
    assert one.sheets == [whole]
    assert several.dataset().equals(one.dataset())
    assert several.heights().equals(one.heights())
    assert several.obstacles().equals(one.obstacles())
    assert repr(several).splitlines()[1:] == repr(one).splitlines()[1:]
    keys = ["row", "col"]
    found, expected = (part.tiles().drop(columns="heights").sort_values(keys) for part in (several, one))
    assert found.reset_index(drop=True).equals(expected.reset_index(drop=True))
    assert several.regions()["tiles"].sum() == one.regions()["tiles"].sum()


def test_a_way_crosses_borders_of_sheets_at_the_same_cost(tmp_path):
    made = site()
    (tmp_path / "whole").mkdir()
    write_products(CostTable.of(made), tmp_path / "whole", views=write_map_views, local=False, manifest=RUN)
    write(made, tmp_path / "sheets")
    assert len(sheet_folders(tmp_path / "sheets")) >= 4
    ends = tuple(tuple(map(float, place(row, col).split(","))) for row, col in ((20.5, 8.5), (20.5, 22.5)))
    one, other = (bumpymap.find_routes(tmp_path / name, *ends)[0] for name in ("whole", "sheets"))
    np.testing.assert_array_equal(other.line, one.line)
    assert other.figures == one.figures
    exported = [
        bumpymap.open(tmp_path / name).export(tmp_path / f"{name}.nav2", to="nav2") for name in ("whole", "sheets")
    ]
    assert len({(done.files[0].parent / "map.pgm").read_bytes() for done in exported}) == 1


class TestUnfinished:
    """A run that is killed while it writes."""

    @pytest.fixture
    def killed(self, made, tmp_path, monkeypatch):
        """A map of which the third sheet was not finished; the fixture also counts what is written later."""
        written = []

        def stop(table, sheet, **options):
            if len(written) == 2:
                raise KeyboardInterrupt
            written.append(sheet.name)
            return write_products(table, sheet, **options)

        monkeypatch.setattr(writing, "write_products", stop)
        with pytest.raises(KeyboardInterrupt):
            write(made, tmp_path / "out", blocks=4)
        written.clear()
        monkeypatch.setattr(
            writing, "write_products", lambda table, sheet, **options: (
                written.append(sheet.name), write_products(table, sheet, **options)
            )
        )  # fmt: skip
        return tmp_path / "out", written

    def test_it_goes_on_and_keeps_what_is_finished(self, killed, made, sheets):
        folder, written = killed
        write(made, folder, blocks=4, keep=True)
        assert written == names_in(sheets)[2:]
        for name in ("class.vrt", "sheets.csv"):
            assert (folder / name).read_bytes() == (sheets / name).read_bytes() or name == "sheets.csv"
        assert bumpymap.open(folder).dataset().equals(bumpymap.open(sheets).dataset())

    def test_without_room_for_the_page_it_is_no_map_and_goes_on(self, made, sheets, tmp_path, monkeypatch):
        """Everything is there then but what the last step writes."""

        def full(folder, record):
            if "sheets" in record:
                raise OutputError("no space left on device")
            write_map_views(folder, record)

        with pytest.raises(OutputError, match="no space left"):
            write(made, tmp_path / "out", blocks=4, views=full)
        assert (tmp_path / "out" / "class.vrt").exists()
        with pytest.raises(BadInputError, match=r"sheets are not complete.*same map command again"):
            bumpymap.open(tmp_path / "out")
        written = []
        monkeypatch.setattr(writing, "write_products", lambda *_, **__: written.append(1))
        write(made, tmp_path / "out", blocks=4, keep=True)
        assert not written
        for name in ("report.html", "class.vrt", "map.qgs"):
            assert (tmp_path / "out" / name).read_bytes() == (sheets / name).read_bytes()

    def test_a_sheet_that_has_changed_is_written_again(self, killed, made, sheets):
        folder, written = killed
        with (folder / "sheets" / names_in(sheets)[1] / "cost.tif").open("ab") as file:
            file.write(b"x")
        write(made, folder, blocks=4, keep=True)
        assert written == names_in(sheets)[1:]

    @pytest.mark.parametrize("change", [{"key": "other"}, {"keep": False}])
    def test_sheets_of_other_runs_are_written_again(self, killed, made, sheets, change):
        folder, written = killed
        write(made, folder, blocks=4, **{"keep": True, **change})
        assert written == names_in(sheets)


class TestReplacing:
    """What is removed is what such a run wrote, and nothing behind a link."""

    def test_sheets_replace_a_map_and_leave_files_of_the_user(self, made, whole, tmp_path):
        folder = copy_folder(whole, tmp_path / "out")
        (folder / "notes.txt").write_text("mine")
        write(made, folder, blocks=4)
        assert sorted(path.name for path in folder.iterdir()) == sorted(
            ["notes.txt", "run.json", "sheets", "sheets.csv", *(f"{name}.vrt" for name in RASTERS), *VIEWS]
        )

    def test_larger_sheets_replace_smaller_ones(self, made, sheets, tmp_path):
        folder, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
        shutil.copytree(sheets, folder)
        elsewhere.mkdir()
        (elsewhere / "class.tif").write_text("not of this run")
        old = folder / "sheets" / names_in(sheets)[0]
        (old / "notes.txt").write_text("mine")
        (old / "cost.tif").unlink()
        (old / "cost.tif").symlink_to(elsewhere / "class.tif")
        (folder / "sheets" / "e999999_n999999").symlink_to(elsewhere)
        write(made, folder, blocks=100)
        new = {"e0000_n0000", "e0000_s0001", "w0001_n0000", "w0001_s0001"}
        assert {path.name for path in sheet_folders(folder)} == new
        assert set(names_in(folder)) - new == {old.name, "e999999_n999999"}
        assert [path.name for path in old.iterdir()] == ["notes.txt"]
        assert (elsewhere / "class.tif").read_text() == "not of this run"

    @pytest.mark.parametrize("place", ["sheets", "sheets/e000000_n000000"])
    def test_a_link_in_the_place_of_a_sheet_is_refused(self, made, tmp_path, place):
        out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
        elsewhere.mkdir()
        (out / place).parent.mkdir(parents=True)
        (out / place).symlink_to(elsewhere)
        with pytest.raises(OutputError, match="is a link or a file, and was not touched"):
            write(made, out, blocks=4)
        assert list(elsewhere.iterdir()) == []


class TestFolders:
    def test_a_missing_sheet_is_named(self, sheets, tmp_path):
        shutil.copytree(sheets, tmp_path / "out")
        gone = sheet_folders(tmp_path / "out")[1]
        shutil.rmtree(gone)
        for use in (bumpymap.open, sheet_folders, lambda folder: open_map([folder])):
            with pytest.raises(BadInputError, match=f"has 4 sheets, of which .*{gone.name} is missing"):
                use(tmp_path / "out")

    @pytest.mark.parametrize("name", ["../whole", "sheets/..", "/etc", "sheets/a/b"])
    def test_a_list_that_leads_elsewhere_is_refused(self, sheets, tmp_path, name):
        record = json.loads((sheets / "run.json").read_text())
        record["sheets"][0]["folder"] = name
        (tmp_path / "run.json").write_text(json.dumps(record))
        with pytest.raises(BadInputError, match="is not a sheet"):
            sheet_folders(tmp_path)
