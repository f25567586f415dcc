"""Maps read window by window, folders that are refused; tiles.parquet by GeoPandas; the summary of a map."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from shutil import rmtree

import geopandas
import numpy as np
import pyarrow as pa
import pyarrow.dataset as pads
import pyarrow.parquet as pq
import pytest
import shapely
from cost_maps import lone_columns, make_field, make_map, table_of
from geopandas.testing import assert_geodataframe_equal
from hypothesis import given, settings, strategies as st
from pyproj import CRS
from route_maps import copy_folder, list_anew, write_folder

import bumpymap
from bumpymap.core import NO_CLASS, NO_TILE, BadInputError
from bumpymap.core.types import BANDS, BARRED_TEXT, REASON_TEXT, SIDES, TEXTURES, Barred, Reason
from bumpymap.layers import ZoneCounts, open_map, tile_table
from bumpymap.layers.manifest import summarise
from bumpymap.layers.tile_table import write_tiles
from bumpymap.views import write_report, zones_line
from bumpytiles import Grid, TileTable, TileWindow

READ = ("c_r", "c_r_low", "c_r_high", "p_fail", "obstacle")
SMALL = Grid(3.0, 4)


@pytest.fixture(scope="module")
def made():
    return make_field(50, 37, grid=SMALL, seed=8)


@pytest.fixture(scope="module")
def folder(made, tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("route") / "layers", made)


def same(first, second):
    return all(np.array_equal(getattr(first, name), getattr(second, name), equal_nan=True) for name in READ) and (
        np.array_equal(first.barred, second.barred)
    )


def test_every_tile_lies_where_it_was_measured(folder, made):
    found = open_map(folder)
    field = found.read(found.window)
    row = found.window.row + found.window.rows - 1 - made.patches.row
    col = made.patches.col - found.window.col
    held = np.zeros(field.barred.shape, bool)
    held[row, col] = True
    assert np.array_equal(field.barred == NO_TILE, ~held)
    columns = lone_columns(made)
    assert np.array_equal(field.barred[row, col], columns["barred"])
    for name in READ:
        assert np.array_equal(getattr(field, name)[row, col], columns[name], equal_nan=True), name
        assert np.isnan(getattr(field, name)[~held]).all()
    assert found.rule == made.rule


def test_a_window_is_a_piece_of_the_whole_also_beyond_the_map(folder):
    found = open_map(folder)
    whole = found.window
    around = TileWindow(whole.col - 7, whole.row - 5, whole.cols + 20, whole.rows + 9)
    field, heights, objects = found.read(around), found.heights(around), found.objects(around)
    rng = np.random.default_rng(1)
    for _ in range(10):
        top, left = int(rng.integers(0, 40)), int(rng.integers(0, 60))
        rows, cols = int(rng.integers(1, around.rows - top + 1)), int(rng.integers(1, around.cols - left + 1))
        window = TileWindow(around.col + left, around.row + around.rows - top - rows, cols, rows)
        part = found.read(window)
        for name in ("barred", *READ):
            expected = getattr(field, name)[top : top + rows, left : left + cols]
            assert np.array_equal(getattr(part, name), expected, equal_nan=True)
        pixels = np.s_[4 * top : 4 * (top + rows), 4 * left : 4 * (left + cols)]
        assert np.array_equal(found.heights(window), heights[pixels], equal_nan=True)
        assert np.array_equal(found.objects(window), objects[pixels])


def test_passage_in_fewer_pixels(folder):
    """At full size the same; in fewer pixels, what is free there is free on one of those beneath."""
    found = open_map(folder)
    whole = found.window
    around = TileWindow(whole.col - 2, whole.row - 1, whole.cols + 4, whole.rows + 3)
    fine = found.passage(around)
    assert np.array_equal(found.passage(around, fine.shape), fine)
    rows, cols = fine.shape[0] // 2, fine.shape[1] // 2
    coarse = found.passage(around, (rows, cols))
    assert not (coarse & ~fine[: 2 * rows, : 2 * cols].reshape(rows, 2, cols, 2).any(axis=(1, 3))).any()


def test_coarse_relief_holds_means(folder):
    found = open_map(folder)
    whole = found.window
    blocks = found.heights(whole).reshape(whole.rows, 4, whole.cols, 4)
    known = np.isfinite(blocks).sum(axis=(1, 3))
    means = np.nansum(blocks, axis=(1, 3)) / np.where(known, known, np.nan)
    coarse = found.relief(whole, (whole.rows, whole.cols))
    full = known == 16  # an overview of an overview weighs pixels beside holes differently
    np.testing.assert_allclose(coarse[full], means[full], atol=1e-3)
    np.testing.assert_array_equal(np.isnan(coarse), known == 0)
    assert np.abs(coarse - means)[known > 0].max() < 0.5


def test_threads_read_a_map_that_is_kept_open(folder):
    found = open_map(folder)
    whole = found.window
    corners = np.random.default_rng(3).integers(0, (whole.cols - 5, whole.rows - 5), (60, 2)).tolist()
    windows = [TileWindow(whole.col + col, whole.row + row, 5, 5) for col, row in corners]
    wanted = [(found.read(window), found.passage(window)) for window in windows]

    def read(window):
        with found.kept_open():
            return found.read(window), found.passage(window)

    with ThreadPoolExecutor(4) as pool:
        for (field, passage), (own, open_pixels) in zip(wanted, pool.map(read, windows), strict=True):
            assert same(field, own)
            assert np.array_equal(passage, open_pixels)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("route") / "small", make_field(20, 16, grid=SMALL))


@pytest.mark.parametrize(
    ("change", "entries", "words"),
    [
        (lambda folder: (folder / "run.json").unlink(), {}, "no complete run"),
        (rmtree, {}, "there is no folder"),
        *((lambda _: None, {key: {"a": 1}}, r"run\.json is damaged") for key in ("grid", "files", "crs", "inputs")),
        (lambda _: None, {"metres_per_unit": {"horizontal": 1e308, "vertical": 1}}, r"run\.json is damaged"),
        (lambda _: None, {"grid": {"tile_size_m": 3.0, "pixels": float("inf")}}, r"run\.json is damaged"),
        (lambda _: None, {"format": ["x"]}, "no complete run"),
        (
            lambda _: None,
            {"format": "bumpymap-sheets", "sheets": []},
            r"layers holds a map of another version.*Map the",
        ),
    ],
)
def test_what_is_no_complete_run_of_this_version_is_refused(small, tmp_path, change, entries, words):
    folder = copy_folder(small, tmp_path / "layers", **entries)
    change(folder)
    with pytest.raises(BadInputError, match=words):
        open_map(folder)


def test_rasters_of_another_place_are_refused(small, tmp_path):
    """A raster that was copied from another run; its size and checksum are entered, so only its place is wrong."""
    folder = copy_folder(small, tmp_path / "layers")
    other = write_folder(tmp_path / "other", make_field(20, 17, grid=SMALL))
    (folder / "cost.tif").write_bytes((other / "cost.tif").read_bytes())
    list_anew(folder)
    with pytest.raises(BadInputError, match=r"cost\.tif spans other tiles"):
        open_map(folder)
    list_anew(folder, grid=json.loads((folder / "run.json").read_text())["grid"] | {"tile_size_m": 2.5})
    with pytest.raises(BadInputError, match="does not lie on the grid"):
        open_map(folder)


@pytest.fixture(name="written", scope="module")
def written_fixture(tmp_path_factory, cost_map):
    path = tmp_path_factory.mktemp("table") / "tiles.parquet"
    write_tiles(table_of(cost_map), path)
    return path


def test_columns_types_and_compression(written):
    schema = pq.read_schema(written)
    assert schema.names == [
        *("col", "row", "geometry", "bbox", *(band.name for band in BANDS), *(f"step_{side}" for side in SIDES)),
        *("barred", "count", "z_min", "z_max", "relief", "texture", *(f"p_{texture}" for texture in TEXTURES)),
        *("class", "reason", "reason_text", "heights"),
    ]
    assert schema.field("class").type == schema.field("reason").type == pa.int8()
    assert schema.field("heights").type == pa.list_(pa.float32(), 225)
    assert schema.field("c_r").metadata[b"unit"] == b"rad/m"
    group = pq.ParquetFile(written).metadata.row_group(0)
    assert {group.column(i).compression for i in range(group.num_columns)} == {"ZSTD"}


def test_geopandas_reads_every_value_back(written, cost_map):
    frame = geopandas.read_parquet(written)
    assert frame.crs.equals(CRS.from_epsg(32614))
    patches = cost_map.patches
    order = np.lexsort([patches.col, -patches.row])  # north first, then west
    columns = lone_columns(cost_map)
    for band in BANDS:
        expected = np.where(columns["zone"] > 0, columns["zone"], np.nan) if band.name == "zone" else columns[band.name]
        np.testing.assert_array_equal(frame[band.name].to_numpy(float), expected[order])
    for name in ("col", "row", "count", "z_min", "z_max", "relief", "reason"):
        np.testing.assert_array_equal(frame[name], getattr(patches, name)[order])
    class_id = np.where(cost_map.class_id == NO_CLASS, np.nan, cost_map.class_id)
    np.testing.assert_array_equal(frame["class"], class_id[order])
    for number, texture in enumerate(TEXTURES):
        np.testing.assert_array_equal(frame[f"p_{texture}"], cost_map.probability[order, number])
    np.testing.assert_array_equal(np.stack(frame["heights"]).reshape(-1, 15, 15), patches.heights[order])
    barred = [BARRED_TEXT[code] if code else None for code in lone_columns(cost_map)["barred"][order]]
    assert frame["barred"].astype(object).where(frame["barred"].notna(), None).tolist() == barred
    assert frame["passable"].tolist() == [text is None for text in barred]
    assert frame["reason_text"].tolist() == [REASON_TEXT[Reason(code)] for code in patches.reason[order]]


def test_geometry_is_that_of_geoparquet_with_boxes_that_are_the_bounds_of_the_tiles(written):
    table = pq.read_table(written)
    geo = json.loads(table.schema.metadata[b"geo"])
    assert (geo["version"], geo["primary_column"]) == ("1.1.0", "geometry")
    column, sides = geo["columns"]["geometry"], ("xmin", "ymin", "xmax", "ymax")
    bounds = shapely.bounds(shapely.from_wkb(table["geometry"].to_numpy()))
    assert {name: column[name] for name in ("encoding", "geometry_types", "orientation", "bbox", "covering")} == {
        "encoding": "WKB",
        "geometry_types": ["Polygon"],
        "orientation": "counterclockwise",
        "bbox": [*bounds[:, :2].min(axis=0), *bounds[:, 2:].max(axis=0)],
        "covering": {"bbox": {side: ["bbox", side] for side in sides}},
    }
    assert CRS.from_json_dict(column["crs"]) == CRS.from_epsg(32614)
    boxes = table["bbox"].combine_chunks()
    assert boxes.type == pa.struct([pa.field(side, pa.float64(), nullable=False) for side in sides])
    np.testing.assert_array_equal(np.stack(boxes.flatten()), bounds.T)


def test_a_reader_with_a_box_skips_row_groups(tmp_path):
    path = tmp_path / "t.parquet"
    write_tiles(table_of(make_field(400, 200, grid=Grid(3.0, 1))), path)
    whole = geopandas.read_parquet(path)
    west, south, _, _ = whole.total_bounds
    box = (west + 100.5, south + 50.5, west + 130.5, south + 80.5)
    found = geopandas.read_parquet(path, bbox=box)
    inside = whole[whole.intersects(shapely.box(*box))]
    assert len(inside) > 50
    assert_geodataframe_equal(found.reset_index(drop=True), inside.reset_index(drop=True))
    low, high = (pads.field("bbox", "xmin") <= box[2]), (pads.field("bbox", "xmax") >= box[0])
    meets = low & high & (pads.field("bbox", "ymin") <= box[3]) & (pads.field("bbox", "ymax") >= box[1])
    (fragment,) = pads.dataset(path).get_fragments()
    groups = [group.id for part in fragment.split_by_row_group(meets) for group in part.row_groups]
    assert 0 < len(groups) < pq.ParquetFile(path).metadata.num_row_groups == 5


@pytest.fixture
def site(tmp_path):
    return write_folder(tmp_path / "site", make_field(12, 9))


def repeated(site, times):
    """Return the tiles many times over: a small file, since equal rows take next to nothing."""
    table = pq.read_table(site / "tiles.parquet").drop_columns(["heights", "geometry", "bbox"])
    return table.take(pa.array(np.repeat(np.arange(len(table)), times)))


def test_more_rows_than_the_run_counts_are_refused_before_they_are_read(site):
    pq.write_table(repeated(site, 10_000), site / "tiles.parquet")
    list_anew(site)
    before = pa.default_memory_pool()
    pool = pa.proxy_memory_pool(before)
    pa.set_memory_pool(pool)
    try:
        for read in (lambda: write_report(site), bumpymap.open(site).tiles):
            with pytest.raises(
                BadInputError, match=r"tiles\.parquet holds [\d,]+ rows, and run\.json counts \d+ tiles"
            ):
                read()
    finally:
        pa.set_memory_pool(before)
    assert pool.max_memory() < 1 << 20


def test_a_row_group_larger_than_a_run_writes_is_refused(site):
    table = repeated(site, 1000)
    pq.write_table(table, site / "tiles.parquet", row_group_size=len(table))
    counts = json.loads((site / "run.json").read_text(encoding="utf-8"))["counts"]
    list_anew(site, counts=counts | {"tiles": len(table)})
    with pytest.raises(BadInputError, match=r"a group of [\d,]+ rows; at most 65,536 are read at once"):
        write_report(site)


def test_rows_that_do_not_fit_into_memory_are_refused(site, monkeypatch):
    monkeypatch.setattr(tile_table, "free_memory", lambda: 1000)
    with pytest.raises(BadInputError, match=r"tiles\.parquet takes .* of memory, and .* are free"):
        write_report(site)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.sampled_from([0, 1, 2, 3, NO_CLASS]), min_size=1, max_size=30), st.integers(0, 9), st.integers(1, 40)
)
def test_counts_and_medians_are_those_of_all_tiles(class_id, seed, cols):
    tiles = np.arange(len(class_id))
    cost_map = make_map(tiles % cols, tiles // cols, class_id, [3 if k == NO_CLASS else 0 for k in class_id], seed=seed)
    summary = summarise(table_of(cost_map))
    assert summary.tiles == len(class_id)
    assert summary.points == cost_map.patches.count.sum()
    assert summary.median_count == np.median(cost_map.patches.count)
    assert summary.by_class == tuple(class_id.count(k) for k in range(4))
    free = (cost_map.class_id != NO_CLASS) & (cost_map.p_fail < 0.5)
    assert summary.passable == (free & (cost_map.patches.slope <= cost_map.rule.slope_limit_deg)).sum()
    assert summary.by_reason == (0, 0, 0, class_id.count(NO_CLASS), 0, 0)
    for number, group in enumerate([0, 1, 2, 3, NO_CLASS]):
        chosen = cost_map.class_id == group
        for found, values, near in (
            (summary.median_c_r, cost_map.c_r, 1e-4),
            (summary.median_slope, cost_map.patches.slope, 1e-3),
        ):
            known = values[chosen][np.isfinite(values[chosen])].astype(float)
            expected = np.median(known) if len(known) else np.nan
            assert found[number] == pytest.approx(expected, abs=near, nan_ok=True)


def test_the_median_of_the_last_class_is_of_the_tiles_that_their_c_r_puts_there():
    cost_map = make_map(np.arange(5), np.zeros(5, int), [3, 3, 3, 3, 0], [0] * 5)
    cost_map.c_r[:] = [0.1, 0.2, 0.5, 0.7, 0.05]
    cost_map.p_fail[:] = [0.9, 0.02, 0.9, 0.0, 0.0]  # the second is too steep
    summary = summarise(table_of(cost_map), (0.1, 0.2, 0.4))
    assert summary.failing == 2
    assert summary.median_c_r[3] == pytest.approx(0.6, abs=1e-4)
    assert summary.by_class == (1, 0, 0, 4)


def test_what_hangs_together_is_counted_and_small_pieces_but_the_largest_are_islands():
    zone = np.repeat([1, 2, 3, 0], [100, 60, 5, 1]).astype(np.int32)  # 900, 540 and 45 m2
    cost_map = make_map(np.arange(len(zone)), np.zeros(len(zone), int), [0] * len(zone), [0] * len(zone), easy=True)
    columns = lone_columns(cost_map) | {"zone": zone}
    columns["barred"][[0, 164]] = Barred.SPLIT
    summary = summarise(replace(table_of(cost_map), tiles=TileTable.of(cost_map.patches.grid, columns)))
    assert summary.zones == ZoneCounts(3, 99, 891.0, 99 / 164, 1, 4)
    line = "60% of what can be crossed hangs together in one piece of 891 m²"
    assert zones_line(summary.zones, "%") == f"{line}; 4 tiles lie on islands under 500 m²"
    alone = ZoneCounts.of(np.array([0, 7]), 7, 9.0)
    assert alone.island_tiles == 0
    assert zones_line(alone, "%") == "100% of what can be crossed hangs together in one piece of 63 m²"
    assert zones_line(ZoneCounts.of(np.zeros(0, int), 0, 9.0)) == ""
