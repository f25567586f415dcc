"""What leads to the sheets of a map: its page, styles, a QGIS project, attribute tables, a thumbnail."""

import json
import re
import shutil
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from cost_maps import make_map
from route_maps import RUN
from sheet_maps import SMALL, write_in_sheets as write

from bumpymap.core.types import CostTable
from bumpymap.layers import remove_sheets, write_catalog, write_products
from bumpymap.layers.products import PRODUCT_NAMES, VIEW_NAMES
from bumpymap.layers.sheet_paths import sheet_folders
from bumpymap.views import read_thumbnail, write_map_views
from bumpymap.views.page import site as pages
from bumpymap.views.page.site import Site
from bumpymap.views.page.tiles import NOT_KNOWN


def record_of(folder):
    return json.loads((folder / "run.json").read_text())


class TestPage:
    @pytest.mark.parametrize("tiles_a_pixel", [1, 4, 10])
    def test_it_shows_what_the_page_of_one_map_shows(self, whole, sheets, monkeypatch, tiles_a_pixel):
        """Also where a pixel of the page spans tiles of two sheets."""
        if tiles_a_pixel > 1:
            monkeypatch.setattr(pages, "_SIDE", -(-70 // tiles_a_pixel))
        one, several = (Site.read(folder, record_of(folder)) for folder in (whole, sheets))
        assert one.tiles.spot == several.tiles.spot
        assert one.tiles.spot.step == tiles_a_pixel
        assert one.summary == several.summary
        for name in ("ground", "barred", "objects", "c_r", "p_fail", "slope", "cost", "c_r_bins", "slope_bins"):
            left, right = getattr(one.tiles, name), getattr(several.tiles, name)
            assert np.array_equal(left, right, equal_nan=left.dtype.kind == "f"), name
        assert np.array_equal(one.objects, several.objects)
        first, second = one.grids[-1], several.grids[-1]
        known = first.codes != NOT_KNOWN
        assert np.array_equal(known, second.codes != NOT_KNOWN)
        heights, found = (grid.low + grid.step * grid.codes[known] for grid in (first, second))
        # The overviews of two rasters do not share all their pixels.
        near = first.step if tiles_a_pixel == 1 else 0.02 * heights.std()
        assert np.abs(heights - found).mean() <= near

    def test_it_leads_to_the_page_of_every_sheet(self, sheets):
        page = (sheets / "report.html").read_text()
        links = [unquote(link) for link in re.findall(r'href="([^"#]+)"', page)]
        folders = [folder.relative_to(sheets) for folder in sheet_folders(sheets)]
        assert links == ["sheets.csv", *(f"{folder}/report.html" for folder in folders)]
        assert all((sheets / link).is_file() for link in links)
        assert 'href="#sheets"' in page
        assert 'id="sheets"' in page

    def test_sites_far_apart_have_a_page_and_a_picture(self, tmp_path):
        """Nothing that takes room or time lies between them: 2.8 million million pixels."""
        far = tmp_path / "far"
        write(make_map([0, 333_333], [0, 333_333], [0, 1], [0, 0], grid=SMALL), far, blocks=100)
        site = Site.read(far, record_of(far))
        assert (site.grids[-1].codes != NOT_KNOWN).sum() == 2
        assert read_thumbnail(far, 12_000)


class TestQgisFiles:
    def test_styles_are_those_of_one_map(self, whole, sheets):
        names = {path.name for path in sheets.glob("*.qml")}
        assert names == {name for name in VIEW_NAMES if name.endswith(".qml")} - {"tiles.qml"}
        for name in names - {"cost.qml"}:  # that of one map also holds how regions look
            assert (sheets / name).read_bytes() == (whole / name).read_bytes(), name
        assert (sheets / "cost.qml").stat().st_size < (whole / "cost.qml").stat().st_size

    def test_the_project_lists_the_virtual_rasters(self, whole, sheets):
        found, expected = (
            [
                element.text
                for element in ET.parse(folder / "map.qgs").iter("datasource")  # noqa: S314 (ours)
            ]
            for folder in (sheets, whole)
        )
        assert found == [name.replace(".tif", ".vrt") for name in expected if name.endswith(".tif")]


def test_the_catalogue_has_every_sheet(sheets):
    pystac = pytest.importorskip("pystac")
    catalog = pystac.Catalog.from_file(str(sheets / "catalog.json"))
    folders = [str(folder / "item.json") for folder in sheet_folders(sheets)]
    assert [item.get_self_href() for item in catalog.get_items()] == folders
    write_catalog(sheets.parent, [sheets.name, "nothing"], title="Night")
    night = pystac.Catalog.from_file(str(sheets.parent / "catalog.json"))
    assert [item.get_self_href() for item in night.get_items(recursive=True)] == folders


def test_one_map_replaces_sheets_and_all_that_led_to_them(made, sheets, whole, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(sheets, folder)
    write_products(CostTable.of(made), folder, views=write_map_views, local=False, manifest=RUN)
    remove_sheets(folder)
    names = {path.name for path in folder.iterdir()}
    assert names == {path.name for path in whole.iterdir()}
    assert names >= {*PRODUCT_NAMES, *VIEW_NAMES}
    assert (folder / "report.html").read_bytes() == (whole / "report.html").read_bytes()
