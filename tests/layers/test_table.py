import json

import geopandas
import numpy as np
import pyarrow as pa
import pyarrow.dataset as pads
import pyarrow.parquet as pq
import pytest
import shapely
from geopandas.testing import assert_geodataframe_equal
from pyproj import CRS

from bumpymap.core.types import (
    BANDS,
    BARRED_TEXT,
    NO_CLASS,
    REASON_TEXT,
    SIDES,
    TEXTURES,
    CostTable,
    Reason,
)
from bumpymap.layers.tile_table import write_tiles
from bumpytiles import Column, Grid, Pack, TileTable, write_pack

COLUMNS = [
    "col", "row", "geometry", "bbox", *(band.name for band in BANDS),
    *(f"step_{side}" for side in SIDES), "barred", "count", "z_min", "z_max", "relief", "texture",
    *(f"p_{texture}" for texture in TEXTURES), "class", "reason", "reason_text", "heights",
]  # fmt: skip


@pytest.fixture(name="written", scope="module")
def written_fixture(tmp_path_factory, cost_map):
    path = tmp_path_factory.mktemp("table") / "tiles.parquet"
    write_tiles(CostTable.of(cost_map), path)
    return path


def test_columns_types_and_compression(written):
    schema = pq.read_schema(written)
    assert schema.names == COLUMNS
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
    assert table.schema.field("bbox").type == pa.struct(
        [pa.field(side, pa.float64(), nullable=False) for side in sides]
    )
    for values, expected in zip(table["bbox"].combine_chunks().flatten(), bounds.T, strict=True):
        np.testing.assert_array_equal(values, expected)


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
    assert sorted(zip(found["col"], found["row"], strict=True)) == sorted(
        zip(cost_map.patches.col, cost_map.patches.row, strict=True)
    )
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
