"""The page and the style of what has changed: what change.json says, unknown ground apart, no name trusted."""

import json
import re
import shutil

import numpy as np
import pytest
import rasterio
from page_outline import Outline
from pyproj import Transformer
from route_maps import write_folder
from survey_pairs import COLS, ROWS, survey

import bumpymap
from bumpymap.core import CHANGE_KINDS, BadInputError, OutputError, UsageError
from bumpymap.views import write_report
from bumpymap.views.page.change_page import NOT_COMPARED
from bumpymap.views.words import area


def band(folder, name):
    with rasterio.open(folder / "change.tif") as file:
        return file.read(file.descriptions.index(name) + 1)


def places_of(page):
    """Rows of the table of places, by the number of the place."""
    return {re.match(r"\d+", row[0])[0]: row for row in Outline(page.text).tables["Places that have changed"][1:]}


def test_tables_equal_the_counts_of_the_record(comparison, read_page):
    record = json.loads((comparison / "change.json").read_text())
    counts, tables = record["counts"], Outline(read_page(comparison / "report.html").text).tables
    assert counts["changed"] > 30
    kinds = tables["Tiles by what became of them"][1:]
    for name, row in zip(CHANGE_KINDS, kinds, strict=False):
        assert row[0].startswith(name)
        assert row[2:] == [area(9 * counts["by_change"][name]), f"{counts['by_change'][name]:,}"]
    assert [row[3] for row in kinds[5:]] == [
        f"{counts['compared']:,}",
        f"{counts['in_both'] - counts['compared']:,}",
    ]
    classes = [[int(cell.replace(",", "")) for cell in row[1:]] for row in tables["Tiles by class"][1:]]
    assert classes == record["classes"]["tiles_before_after"]
    surveys = {row[0]: row[1:] for row in tables["Before and after"][1:]}
    assert surveys["name"] == ["pit <b>", "pit <b>"]
    assert surveys["dates in the files"] == ["2024-05-01", "2025-05-02 to 2025-05-03"]


def test_places_are_those_of_the_features(comparison, read_page):
    page = read_page(comparison / "report.html")
    features = json.loads((comparison / "change.geojson").read_text())["features"]
    rows = places_of(page)
    assert [int(row[2]) for row in rows.values()] == sorted((f["properties"]["tiles"] for f in features), reverse=True)
    by_number = {str(feature["id"]): feature["properties"] for feature in features}
    to_lonlat = Transformer.from_crs("EPSG:32614", "OGC:CRS84", always_xy=True)
    spots = {spot["name"]: spot for spot in page.data["maps"][0]["places"]}
    assert set(spots) == set(by_number) == set(rows)
    for number, row in rows.items():
        about, spot = by_number[number], spots[number]
        assert f"rougher in {about['rougher']}" in page.text or about["rougher"] in {0, about["tiles"]}
        assert float(row[3]) == pytest.approx(about["d_height"], abs=0.0051)
        assert float(row[8]) == pytest.approx(about["d_c_r"], abs=0.00051)
        assert to_lonlat.transform(spot["east"], spot["north"]) == pytest.approx(tuple(map(float, row[-2:])), abs=1e-3)


def test_values_of_the_page_are_those_of_the_raster_within_its_rounding(comparison, read_page):
    page = read_page(comparison / "report.html")
    changed, kinds = band(comparison, "changed"), page.codes("ground")
    compared = np.isfinite(changed)
    assert 0 < compared.sum() < compared.size
    assert (kinds[compared] == changed[compared]).all()
    assert (kinds[~compared] == NOT_COMPARED).all()
    for key in ("d_height", "d_c_r"):
        shown, grid = page.values(key)
        wanted = np.where(compared, band(comparison, key), np.nan)
        assert (np.isnan(shown) == np.isnan(wanted)).all(), key
        known = np.isfinite(wanted)
        off = np.abs(np.sign(shown) * np.sqrt(np.abs(shown)) - np.sign(wanted) * np.sqrt(np.abs(wanted)))
        assert off[known].max() <= grid["step"] / 2 + 1e-6, key


def test_nothing_found_and_nothing_compared_are_not_the_same(may, tmp_path, read_page):
    same = bumpymap.diff_surveys(may, may, tmp_path / "same")
    assert same.regions()["kind"].tolist() == []
    assert same.regions().crs.to_epsg() == 32614
    assert "No change was found on the 1.08 ha that were compared" in read_page(same.folder / "report.html").text
    folder = shutil.copytree(same.folder, tmp_path / "none")
    record = json.loads((folder / "change.json").read_text())
    record["counts"] |= {"compared": 0}
    (folder / "change.json").write_text(json.dumps(record))
    assert "is not known" in read_page(write_report(folder)).text


@pytest.mark.parametrize("step", [2, 7])
def test_a_change_is_seen_in_a_pixel_of_several_tiles(comparison, tmp_path, monkeypatch, read_page, step):
    import bumpymap.views.page.change_page as module

    fine = read_page(comparison / "report.html").codes("ground")
    monkeypatch.setattr(module, "_SIDE", -(-max(fine.shape) // step))
    monkeypatch.setattr(module, "_STRIP_TILES", 100)
    page = read_page(write_report(comparison, tmp_path / "coarse.html"))
    assert page.data["maps"][0]["metres"] == 3 * step
    kinds, (shown, _) = page.codes("ground"), page.values("d_height")
    heights = np.where(np.isfinite(band(comparison, "changed")), band(comparison, "d_height"), np.nan)
    for row, col in np.ndindex(kinds.shape):
        part = np.s_[row * step : (row + 1) * step, col * step : (col + 1) * step]
        tiles = fine[part]
        changed = tiles[(tiles > 0) & (tiles != NOT_COMPARED)]
        if len(changed):
            assert kinds[row, col] == next(code for code in (2, 4, 3, 1) if code in changed)
        else:
            assert kinds[row, col] == tiles.max()
        if kinds[row, col] == NOT_COMPARED:
            assert np.isnan(shown[row, col])
        else:
            assert abs(shown[row, col]) == pytest.approx(np.nanmax(np.abs(heights[part])), abs=0.01)


def test_the_page_made_again_has_the_same_bytes(comparison, tmp_path):
    twin = shutil.copytree(comparison, tmp_path / "caf\udce9")
    (twin / "report.html").unlink()
    assert write_report(twin) == twin / "report.html"
    assert (twin / "report.html").read_bytes() == (comparison / "report.html").read_bytes()
    out = write_report(twin, tmp_path / "elsewhere.html")
    assert out.read_bytes() == (comparison / "report.html").read_bytes()
    with pytest.raises(OutputError, match="exists"):
        write_report(twin, out)


def test_what_cannot_be_made_says_why(comparison, may, tmp_path):
    with pytest.raises(UsageError, match="`route`"):
        write_report(comparison, route=may)
    for name, content, told in (
        ("change.json", "{", r"change\.json is not that of a comparison"),
        ("change.json", '{"format": "bumpymap-change"}', r"change\.json is damaged"),
        ("change.tif", "II*", r"change\.tif is cut off"),
        ("change.geojson", '{"features": []}', r"change\.geojson is cut off"),
    ):
        twin = shutil.copytree(comparison, tmp_path / f"{name}{len(content)}")
        (twin / name).write_text(content)
        with pytest.raises(BadInputError, match=told):
            write_report(twin)
    twin = shutil.copytree(comparison, tmp_path / "gone")
    (twin / "change.tif").unlink()
    with pytest.raises(BadInputError, match=r"change\.tif is missing"):
        write_report(twin)


def test_without_a_crs(tmp_path, read_page):
    from bumpymap.core import Georeference

    sides = [
        write_folder(tmp_path / str(seed), survey(seed, rut=rut, georeference=Georeference(None)))
        for seed, rut in ((1, 0.0), (2, 0.1))
    ]
    change = bumpymap.diff_surveys(*sides, tmp_path / "out")
    page = read_page(change.folder / "report.html")
    number, row = next(iter(places_of(page).items()))
    (spot,) = [spot for spot in page.data["maps"][0]["places"] if spot["name"] == number]
    west, north = float(row[-2]), float(row[-1])
    assert abs(west - spot["east"]) <= spot["size"][0] / 2
    assert abs(north - spot["north"]) <= spot["size"][1] / 2
    assert "no place on Earth" in page.text
    collection = json.loads((change.folder / "change.geojson").read_text())
    assert "local_coordinates" in collection
    assert 480_000 <= collection["bbox"][0] < collection["bbox"][2] <= 480_120


def test_the_call_of_python_gives_what_the_files_hold(may, comparison, tmp_path):
    geopandas = pytest.importorskip("geopandas")
    record = json.loads((comparison / "change.json").read_text())
    change = bumpymap.diff_surveys(bumpymap.open(may), record["settings"]["after"])
    assert change.folder is None
    assert json.loads(json.dumps(change.counts)) == record["counts"]
    table, written = change.regions(), geopandas.read_file(comparison / "change.geojson")
    assert table.crs.to_epsg() == 32614
    assert table.index.tolist() == [*range(1, len(written) + 1)]
    assert table["kind"].tolist() == written["kind"].tolist()
    assert np.allclose(table.area, table["area_m2"])
    assert table.to_crs(4326).geometry.union_all().symmetric_difference(written.union_all()).area < 1e-9
    assert change.field.changed.shape == (ROWS, COLS)
    with pytest.raises(UsageError, match="fdr"):
        bumpymap.diff_surveys(may, may, fdr=2.0)
