from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import rasterio
from cost_maps import part_of
from pyproj import CRS
from rasterio.env import get_gdal_config
from rio_cogeo import cog_validate

from bumpymap.core.types import (
    BANDS,
    BARRED_TEXT,
    CANOPY,
    CLASS_NAMES,
    FREE,
    NO_CLASS,
    OBJECT_NAMES,
    OBSTACLE,
    REASON_TEXT,
    UNSEEN,
    CostTable,
    Georeference,
    ObjectStack,
    Reason,
)
from bumpymap.layers import _cog
from bumpymap.layers._cog import checksum, require_intact
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS, OBJECT_COLOURS, REASON_COLOURS
from bumpymap.layers.geotiff import write_raster
from bumpymap.layers.products import MapFile
from bumpytiles import Grid

WRITERS = {
    Path(file).stem: lambda cost_map, *rest, file=file: write_raster(file, CostTable.of(cost_map), *rest)
    for file in MapFile
    if file.endswith(".tif") and file not in {MapFile.PASSAGE, MapFile.SPEEDS}
}
WEIGHTS = ("ride_weight_m_per_rad", "fail_weight_m", "drive_m", "slope_limit_deg")
US_FOOT = 1200 / 3937
FEET = Georeference(CRS.from_epsg(2271), US_FOOT, US_FOOT)


@pytest.fixture(scope="module")
def rasters(tmp_path_factory, cost_map):
    folder = tmp_path_factory.mktemp("rasters")
    for name, write in WRITERS.items():
        write(cost_map, folder / f"{name}.tif", {"vehicle": "warthog"})
    return {name: folder / f"{name}.tif" for name in WRITERS}


def of_tiles(path, cost_map):
    """Pixels of the tiles, (bands, tiles, pixels, pixels), and of what holds none; placed apart from the package."""
    size = cost_map.patches.grid.tile_size / cost_map.georeference.metres_per_unit
    with rasterio.open(path) as file:
        pixels, place, side = file.read(), file.transform, round(size / file.res[0])
    left = np.rint((cost_map.patches.col * size - place.c) / place.a).astype(int)
    top = np.rint(((cost_map.patches.row + 1) * size - place.f) / place.e).astype(int)
    index = top[:, None, None] + np.arange(side)[:, None], left[:, None, None] + np.arange(side)
    rest = np.ones(pixels.shape[1:], bool)
    rest[index] = False
    assert rest.any()
    return pixels[:, *index], pixels[:, rest]


@pytest.mark.parametrize("name", WRITERS)
def test_is_a_strictly_valid_cog_in_the_right_place(rasters, cost_map, name):
    assert cog_validate(rasters[name], strict=True) == (True, [], [])
    patches = cost_map.patches
    with rasterio.open(rasters[name]) as file:
        assert file.crs.to_epsg() == 32614
        assert file.bounds == (
            patches.col.min() * 3.0,
            patches.row.min() * 3.0,
            (patches.col.max() + 1) * 3.0,
            (patches.row.max() + 1) * 3.0,
        )
        side = {"heightmap": 0.2, "obstacle": 0.2, "relief": 1.0}.get(name, 3.0)
        assert file.transform == rasterio.Affine(side, 0.0, file.bounds.left, 0.0, -side, file.bounds.top)
        assert (file.tags()["vehicle"], file.tags()["AREA_OR_POINT"]) == ("warthog", "Area")


def test_roughness_of_a_tile_is_its_value(rasters, cost_map):
    with rasterio.open(rasters["roughness"]) as file:
        assert file.descriptions == tuple(band.name for band in BANDS)
        assert file.units == tuple(band.unit or None for band in BANDS)
        assert set(file.dtypes) == {"float32"}
        assert np.isnan(file.nodatavals).all()
    found, rest = of_tiles(rasters["roughness"], cost_map)
    for band, values in zip(BANDS, found, strict=True):
        np.testing.assert_array_equal(values.ravel(), cost_map.lone_columns()[band.name].astype(np.float32))
    assert np.isnan(rest).all()


@pytest.mark.parametrize("name", ["class", "reason"])
def test_classes_and_reasons(rasters, cost_map, name):
    with rasterio.open(rasters[name]) as file:
        assert (file.descriptions, file.dtypes, file.nodata) == ((name,), ("uint8",), NO_CLASS)
        assert [kind.name for kind in file.colorinterp] == ["palette"]
        assert file.colormap(1)[NO_CLASS][3] == 0
    found, rest = of_tiles(rasters[name], cost_map)
    np.testing.assert_array_equal(found.ravel(), cost_map.class_id if name == "class" else cost_map.patches.reason)
    assert (rest == NO_CLASS).all()  # what holds no points has no reason: nodata, not "ok"


def test_cost_is_there_where_a_tile_is_passable_and_nowhere_else(rasters, cost_map):
    with rasterio.open(rasters["cost"]) as file:
        assert (file.descriptions, file.dtypes) == (("cost",), ("float32",))
        assert np.isnan(file.nodata)
        ride, fail, drive, steep = (float(file.tags()[name]) for name in WEIGHTS)
    p_fail = cost_map.p_fail.astype(float)
    with np.errstate(divide="ignore"):
        expected = 1 + ride * cost_map.c_r.astype(float) - fail * np.log(1 - p_fail) / drive
    passable = (cost_map.class_id != NO_CLASS) & (p_fail < 0.5) & (cost_map.patches.slope <= steep)
    assert 0 < passable.sum() < (cost_map.class_id != NO_CLASS).sum()
    found, rest = of_tiles(rasters["cost"], cost_map)
    np.testing.assert_allclose(found.ravel(), np.where(passable, expected, np.nan), rtol=1e-6)
    assert np.isnan(rest).all()


def test_heightmap_is_the_heights_side_by_side(rasters, cost_map):
    with rasterio.open(rasters["heightmap"]) as file:
        assert (file.descriptions, file.units) == (("height",), ("m",))
    found, rest = of_tiles(rasters["heightmap"], cost_map)
    np.testing.assert_array_equal(found[0], cost_map.patches.heights)
    assert np.isnan(rest).all()


def test_obstacles_are_pixels_of_the_tiles(cost_map, tmp_path):
    rng = np.random.default_rng(3)
    objects = rng.choice(np.array([FREE, OBSTACLE, CANOPY, UNSEEN], np.uint8), cost_map.patches.heights.shape)
    share = np.mean(objects == OBSTACLE, axis=(1, 2)).astype(np.float32)
    share[5] = np.nan  # its free pixels are not known to be free
    stack = ObjectStack(objects, share, share, share, share)
    write_raster(MapFile.OBSTACLE, CostTable.of(replace(cost_map, objects=stack)), tmp_path / "obstacle.tif")
    expected = np.where(objects == UNSEEN, 3, objects)
    expected[5] = np.where(objects[5] == FREE, 3, expected[5])
    found, rest = of_tiles(tmp_path / "obstacle.tif", cost_map)
    np.testing.assert_array_equal(found[0], expected)
    assert (rest == NO_CLASS).all()


VALUES = {
    "class": (CLASS_NAMES, CLASS_COLOURS),
    "reason": (tuple(REASON_TEXT.values()), REASON_COLOURS),
    "barred": (tuple(BARRED_TEXT.values()), BARRED_COLOURS),
    "obstacle": (OBJECT_NAMES, OBJECT_COLOURS),
}
RAT_COLUMNS = {"Value": "5", "Count": "1", "Class": "2", "Red": "6", "Green": "7", "Blue": "8", "Alpha": "9"}
"""The usages are those of GDAL's GDALRATFieldUsage."""


def check_value_table(raster, name, scratch):
    """Hold names and attribute table of band 1, as GDAL itself reads them, against its pixels and its palette."""
    rasterio.shutil.copy(raster, scratch, driver="VRT")
    band = ET.parse(scratch).getroot().find("VRTRasterBand")  # noqa: S314 (GDAL has just written it)
    wanted, colours = VALUES[name]
    assert tuple(element.text for element in band.findall("CategoryNames/Category")) == wanted
    table = band.find("GDALRasterAttributeTable")
    assert table.get("tableType") == "thematic"
    columns = {field.findtext("Name"): field.findtext("Usage") for field in table.findall("FieldDefn")}
    assert columns == RAT_COLUMNS
    with rasterio.open(raster) as file:
        counts, palette = np.bincount(file.read(1).ravel(), minlength=256), file.colormap(1)
    codes = [code for code in range(len(wanted)) if (name, code) != ("reason", Reason.NO_POINTS)]
    rows = [[cell.text for cell in row.findall("F")] for row in table.findall("Row")]
    assert rows == [[str(cell) for cell in (code, counts[code], wanted[code], *colours[code])] for code in codes]
    assert [palette[code][:3] for code in codes] == [colours[code][:3] for code in codes]
    assert counts[codes].sum() + counts[NO_CLASS] == counts.sum() > counts[NO_CLASS]


@pytest.mark.parametrize("name", VALUES)
def test_gdal_finds_names_colours_and_true_counts_beside_a_raster_of_codes(rasters, tmp_path, name):
    with rasterio.open(rasters[name]) as file:
        assert sorted(path.rsplit("/", 1)[-1] for path in file.files) == [f"{name}.tif", f"{name}.tif.aux.xml"]
    check_value_table(rasters[name], name, tmp_path / "seen.vrt")


def four_below(path):
    """The first overview, and the four pixels below each of its pixels; sides are even."""
    with rasterio.open(path) as file, rasterio.open(path, overview_level=0) as overview:
        assert file.overviews(1) == [2, 4]
        full, small = file.read(1), overview.read(1)
    lines, columns = small.shape
    return small, full.reshape(lines, 2, columns, 2).swapaxes(1, 2).reshape(lines, columns, 4)


def test_overviews_average_and_most_frequent(tmp_path, make_field):
    cost_map = make_field(300, 200, grid=Grid(3.0, 2), holes=0.0)
    for name in ("roughness", "class"):
        WRITERS[name](cost_map, tmp_path / f"{name}.tif")
        assert cog_validate(tmp_path / f"{name}.tif", strict=True)[:2] == (True, [])
    small, below = four_below(tmp_path / "roughness.tif")
    with np.errstate(invalid="ignore"):
        expected = np.nansum(below, axis=2) / np.isfinite(below).sum(axis=2)
    np.testing.assert_allclose(small, expected, rtol=1e-5)
    small, below = four_below(tmp_path / "class.tif")
    codes = np.array([*range(4), NO_CLASS])
    counts = (below[..., None] == codes).sum(axis=2)
    decided = (counts == counts.max(axis=2, keepdims=True)).sum(axis=2) == 1
    assert decided.mean() > 0.5
    np.testing.assert_array_equal(small[decided], codes[counts.argmax(axis=2)[decided]])


@pytest.mark.parametrize("small", [0, 1 << 30], ids=["on disk", "in memory"])
def test_a_large_raster_of_several_bands_has_the_same_overviews(tmp_path, make_field, monkeypatch, small):
    """They are made before it is converted; blocks without values take no room."""
    monkeypatch.setattr(_cog, "SMALL", small)
    cost_map = make_field(520, 260, grid=Grid(3.0, 1))
    inside = (cost_map.patches.col - cost_map.patches.col.min()) < 64
    cost_map = part_of(cost_map, inside | (cost_map.patches.col == cost_map.patches.col.max()))
    WRITERS["roughness"](cost_map, tmp_path / "one.tif")
    monkeypatch.setattr(_cog, "OVERVIEWS_FIRST_FROM", 0)
    WRITERS["roughness"](cost_map, tmp_path / "two.tif")
    assert cog_validate(tmp_path / "two.tif", strict=True)[:2] == (True, [])
    assert (tmp_path / "two.tif").stat().st_size < (tmp_path / "one.tif").stat().st_size + 1000
    for level in (None, 0, 1):
        options = {} if level is None else {"overview_level": level}
        with (
            rasterio.open(tmp_path / "one.tif", **options) as one,
            rasterio.open(tmp_path / "two.tif", **options) as two,
        ):
            np.testing.assert_array_equal(one.read(), two.read())
            assert [one.tags(band) for band in one.indexes] == [two.tags(band) for band in two.indexes]
            assert one.overviews(1) == two.overviews(1)


def test_unknown_ground_is_unknown_in_overviews_too(tmp_path, make_field):
    # One tile in four has a class. GDAL's own overviews leave nodata out of the count: all of them would have one.
    cost_map = make_field(700, 60, grid=Grid(3.0, 1), holes=0.0)
    known = (cost_map.patches.col % 2 == 0) & (cost_map.patches.row % 2 == 0)
    class_id = np.where(known, 0, NO_CLASS).astype(np.uint8)
    reason = np.where(known, Reason.OK, Reason.TOO_FEW_POINTS).astype(np.uint8)
    cost_map = replace(cost_map, class_id=class_id, patches=replace(cost_map.patches, reason=reason))
    WRITERS["class"](cost_map, tmp_path / "class.tif")
    with rasterio.open(tmp_path / "class.tif") as file:
        assert (file.read(1) == 0).sum() == known.sum()
        levels = len(file.overviews(1))
    assert levels == 3
    for level in range(levels):
        with rasterio.open(tmp_path / "class.tif", overview_level=level) as file:
            assert (file.read(1) == NO_CLASS).all()


def test_feet_survey_keeps_its_crs_and_place(tmp_path, make_field):
    cost_map = make_field(20, 10, west=130_000, south=60_000, georeference=FEET)
    for name, values in (("roughness", cost_map.c_r), ("heightmap", cost_map.patches.heights)):
        WRITERS[name](cost_map, tmp_path / f"{name}.tif")
        np.testing.assert_array_equal(np.squeeze(of_tiles(tmp_path / f"{name}.tif", cost_map)[0][0]), values)
    with rasterio.open(tmp_path / "heightmap.tif") as file:
        assert file.crs.to_epsg() == 2271
        assert file.res == pytest.approx((0.2 / US_FOOT, 0.2 / US_FOOT), rel=1e-12)
        assert file.bounds.left == pytest.approx(cost_map.patches.col.min() * 3.0 / US_FOOT, rel=1e-12)
        assert file.units == ("m",)


@pytest.mark.parametrize(("code", "unit_z", "heights", "others"), [
    ("EPSG:32614+5773", 1.0, True, False),
    ("EPSG:2271+6360", US_FOOT, False, False),
])  # fmt: skip
def test_vertical_crs_stays_where_it_is_true(tmp_path, make_field, code, unit_z, heights, others):
    crs = CRS.from_user_input(code)
    unit = crs.axis_info[0].unit_conversion_factor
    cost_map = make_field(4, 4, georeference=Georeference(crs, unit, unit_z))
    WRITERS["heightmap"](cost_map, tmp_path / "h.tif")
    WRITERS["roughness"](cost_map, tmp_path / "r.tif")
    for name, compound in (("h.tif", heights), ("r.tif", others)):
        with rasterio.open(tmp_path / name) as file:
            assert CRS.from_wkt(file.crs.to_wkt()).is_compound is compound
            assert CRS.from_wkt(file.crs.to_wkt()).to_2d().equals(crs.to_2d(), ignore_axis_order=True)


ODD = CRS("+proj=ob_tran +o_proj=tmerc +o_lat_p=30 +o_lon_p=0 +lon_0=5 +type=crs")


@pytest.mark.parametrize("name", ["class", "heightmap"])
def test_a_crs_without_geotiff_keys_is_in_the_side_file_beside_names_and_counts(tmp_path, make_field, name):
    path = tmp_path / f"{name}.tif"
    WRITERS[name](make_field(8, 6, georeference=Georeference(ODD)), path)
    with rasterio.open(path) as file:
        assert "+proj=ob_tran" in file.crs.to_wkt()
    if name in VALUES:
        check_value_table(path, name, tmp_path / "seen.vrt")


@pytest.mark.slow
def test_threads_do_not_change_the_bytes(tmp_path, make_field, monkeypatch):
    cost_map = make_field(200, 150, grid=Grid(3.0, 5))
    for name in ("roughness", "class", "heightmap", "relief"):
        seen = set()
        for threads in ("1", "5"):
            monkeypatch.setattr("bumpymap.layers._cog.gdal_threads", lambda threads=threads: threads)
            WRITERS[name](cost_map, tmp_path / f"{name}.tif")
            seen.add((tmp_path / f"{name}.tif").read_bytes())
        assert len(seen) == 1


def test_the_cache_of_the_process_changes_only_for_the_thread_that_may_write(tmp_path, make_field):
    """A smaller limit makes GDAL flush blocks at once, also those that another thread has not finished."""
    write, path = partial(write_raster, MapFile.CLASS, CostTable.of(make_field(9, 9))), tmp_path / "class.tif"
    write(path)
    path.unlink()
    before = get_gdal_config("GDAL_CACHEMAX")
    with ThreadPoolExecutor(1) as other:
        with _cog.raster_lock():
            written = other.submit(write, path)
            assert not wait([written], 0.3).done
            assert get_gdal_config("GDAL_CACHEMAX") == before
        written.result()
    assert path.exists()
    assert get_gdal_config("GDAL_CACHEMAX") == before


@pytest.mark.parametrize("name", WRITERS)
def test_small_rasters_are_made_in_memory_with_the_same_bytes(rasters, cost_map, tmp_path, monkeypatch, name):
    monkeypatch.setattr("bumpymap.layers._cog.SMALL", 0)
    WRITERS[name](cost_map, tmp_path / rasters[name].name, {"vehicle": "warthog"})
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        path.name for path in rasters[name].parent.iterdir() if path.name.startswith(name)
    )
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (rasters[name].parent / path.name).read_bytes()


def test_a_raster_that_lost_pixels_is_noticed(rasters, tmp_path):
    with rasterio.open(rasters["heightmap"]) as file:
        windows = [window for _, window in file.block_windows(1)]
        painted = [(window, checksum(file.read(window=window))) for window in windows]
        blank = rasterio.open(tmp_path / "blank.tif", "w", **file.profile)
    require_intact(rasters["heightmap"], painted)
    blank.close()
    with pytest.raises(OSError, match="disk may be full"):
        require_intact(tmp_path / "blank.tif", painted)
