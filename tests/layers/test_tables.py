"""tiles.parquet, read by GeoPandas; tables of others, refused before they are read; and the summary of a map."""

import json
from dataclasses import astuple

import geopandas
import numpy as np
import pyarrow as pa
import pyarrow.dataset as pads
import pyarrow.parquet as pq
import pytest
import shapely
from geopandas.testing import assert_geodataframe_equal
from hypothesis import given, settings, strategies as st
from pyproj import CRS
from route_maps import list_anew, write_folder

import bumpymap
from bumpymap.core import CLASS_NAMES, NO_CLASS, BadInputError, CostTable
from bumpymap.core.types import BANDS, BARRED_TEXT, REASON_TEXT, SIDES, TEXTURES, Reason
from bumpymap.layers import MapSummary, tile_table
from bumpymap.layers.summary import summarise
from bumpymap.layers.tile_table import write_tiles
from bumpymap.views import write_report
from bumpytiles import Column, Grid, Pack, TileTable, write_pack


@pytest.fixture(name="written", scope="module")
def written_fixture(tmp_path_factory, cost_map):
    path = tmp_path_factory.mktemp("table") / "tiles.parquet"
    write_tiles(CostTable.of(cost_map), path)
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
    for band in BANDS:
        np.testing.assert_array_equal(frame[band.name].to_numpy(float), cost_map.lone_columns()[band.name][order])
    for name in ("col", "row", "count", "z_min", "z_max", "relief", "reason"):
        np.testing.assert_array_equal(frame[name], getattr(patches, name)[order])
    class_id = np.where(cost_map.class_id == NO_CLASS, np.nan, cost_map.class_id)
    np.testing.assert_array_equal(frame["class"], class_id[order])
    for number, texture in enumerate(TEXTURES):
        np.testing.assert_array_equal(frame[f"p_{texture}"], cost_map.textures.probability[order, number])
    np.testing.assert_array_equal(np.stack(frame["heights"]).reshape(-1, 15, 15), patches.heights[order])
    barred = [BARRED_TEXT[code] if code else None for code in cost_map.lone_columns()["barred"][order]]
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


def test_a_reader_with_a_box_skips_row_groups(tmp_path, make_field):
    path = tmp_path / "t.parquet"
    write_tiles(CostTable.of(make_field(400, 200, grid=Grid(3.0, 1))), path)
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


@pytest.mark.slow
def test_wide_maps_come_strip_by_strip_whatever_the_packs(tmp_path, make_field):
    cost_map = make_field(1500, 40, west=-7, south=5, grid=Grid(3.0, 1))
    table = CostTable.of(cost_map)
    write_tiles(table, tmp_path / "one.parquet")
    found = pq.read_table(tmp_path / "one.parquet", columns=["col", "row"]).to_pandas()
    places = np.column_stack([cost_map.patches.col, cost_map.patches.row]).tolist()
    assert sorted(found.to_numpy().tolist()) == sorted(places)
    block = -(found["row"] // 16)
    assert block.is_monotonic_increasing
    for _, strip in found.groupby(block):  # each in two pieces: the western one first, both north first
        piece = (strip["row"].diff() > 0).cumsum()
        assert piece.max() <= 1
        assert strip[piece == 0]["col"].max() < strip[piece == 1]["col"].min() or piece.max() == 0
        for _, part in strip.groupby(piece):
            assert part.sort_values(["row", "col"], ascending=[False, True]).index.equals(part.index)
    columns = cost_map.lone_columns()
    east = columns["col"] // 16 > 40
    packs = []
    for number, chosen in enumerate((east, ~east)):
        keys = np.stack([columns["row"], columns["col"]], axis=1)[chosen] // 16
        blocks, place, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        order = np.flatnonzero(chosen)[np.argsort(place, kind="stable")]
        described = [Column(name, array.dtype.str, array.shape[1:]) for name, array in columns.items()]
        rows = dict(zip(map(tuple, blocks.tolist()), counts.tolist(), strict=True))
        write_pack(tmp_path / str(number), described, rows, lambda c, order=order: [columns[c.name][order]], {})
        packs.append(Pack(tmp_path / str(number)))
    twin = CostTable(table.georeference, table.rule, TileTable(table.tiles.grid, packs))
    write_tiles(twin, tmp_path / "two.parquet")
    assert (tmp_path / "one.parquet").read_bytes() == (tmp_path / "two.parquet").read_bytes()


@pytest.fixture(name="folder")
def folder_fixture(make_field, tmp_path):
    return write_folder(tmp_path / "site", make_field(12, 9))


def repeated(folder, times):
    """Return the tiles many times over: a small file, since equal rows take next to nothing."""
    table = pq.read_table(folder / "tiles.parquet").drop_columns(["heights", "geometry", "bbox"])
    return table.take(pa.array(np.repeat(np.arange(len(table)), times)))


def test_more_rows_than_the_run_counts_are_refused_before_they_are_read(folder):
    pq.write_table(repeated(folder, 10_000), folder / "tiles.parquet")
    list_anew(folder)
    before = pa.default_memory_pool()
    pool = pa.proxy_memory_pool(before)
    pa.set_memory_pool(pool)
    try:
        for read in (lambda: write_report(folder), bumpymap.open(folder).tiles):
            with pytest.raises(
                BadInputError, match=r"tiles\.parquet holds [\d,]+ rows, and run\.json counts \d+ tiles"
            ):
                read()
    finally:
        pa.set_memory_pool(before)
    assert pool.max_memory() < 1 << 20


def test_a_row_group_larger_than_a_run_writes_is_refused(folder):
    table = repeated(folder, 1000)
    pq.write_table(table, folder / "tiles.parquet", row_group_size=len(table))
    counts = json.loads((folder / "run.json").read_text(encoding="utf-8"))["counts"]
    list_anew(folder, counts=counts | {"tiles": len(table)})
    with pytest.raises(BadInputError, match=r"a group of [\d,]+ rows; at most 65,536 are read at once"):
        write_report(folder)


def test_rows_that_do_not_fit_into_memory_are_refused(folder, monkeypatch):
    monkeypatch.setattr(tile_table, "free_memory", lambda: 1000)
    with pytest.raises(BadInputError, match=r"tiles\.parquet takes .* of memory, and .* are free"):
        write_report(folder)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.sampled_from([0, 1, 2, 3, NO_CLASS]), min_size=1, max_size=30), st.integers(0, 9), st.integers(1, 40)
)
def test_counts_and_medians_are_those_of_all_tiles(make_map, class_id, seed, cols):
    tiles = np.arange(len(class_id))
    cost_map = make_map(tiles % cols, tiles // cols, class_id, [3 if k == NO_CLASS else 0 for k in class_id], seed=seed)
    summary = summarise(CostTable.of(cost_map))
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


def test_the_median_of_the_last_class_is_of_the_tiles_that_their_c_r_puts_there(make_map):
    cost_map = make_map(np.arange(5), np.zeros(5, int), [3, 3, 3, 3, 0], [0] * 5)
    cost_map.c_r[:] = [0.1, 0.2, 0.5, 0.7, 0.05]
    cost_map.p_fail[:] = [0.9, 0.02, 0.9, 0.0, 0.0]  # the second is too steep
    summary = summarise(CostTable.of(cost_map), (0.1, 0.2, 0.4))
    assert summary.failing == 2
    assert summary.median_c_r[3] == pytest.approx(0.6, abs=1e-4)
    assert summary.by_class == (1, 0, 0, 4)


def test_unknown_are_the_tiles_without_a_class():
    """Those with one of which too little was seen are not passable, but not unknown."""
    counts = {
        "tiles": 10,
        "points": 99,
        "passable": 5,
        "by_class": dict(zip(CLASS_NAMES, (5, 1, 1, 1), strict=True)),
        "by_reason": {"too few points": 2},
        "barred": {"unknown ground": 3, "step": 2},
    }
    summary = MapSummary.of(counts)
    assert summary.unknown == 2
    assert summary.crossing == {"passable": 5, "unknown ground": 2, "too little seen": 1, "step": 2}


def test_strips_do_not_change_the_summary(make_field, monkeypatch):
    table = CostTable.of(make_field(50, 40))
    whole = summarise(table)
    monkeypatch.setattr("bumpymap.layers.summary._STRIP", 1)
    for found, expected in zip(astuple(summarise(table)), astuple(whole), strict=True):
        np.testing.assert_array_equal(found, expected)
