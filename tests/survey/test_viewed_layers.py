"""Layers that were opened in a GIS: it saves its own styles and statistics, and the run is still a complete one."""

import json
import shutil

import pytest
from small_surveys import files_in, run, write_survey

from bumpymap.layers.products import VIEW_NAMES

pytestmark = pytest.mark.slow

STATISTICS = (
    "<PAMDataset><PAMRasterBand band='1'><Metadata><MDI key='STATISTICS_MAXIMUM'>1</MDI></Metadata></PAMRasterBand>"
    "</PAMDataset>"
)


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return write_survey(tmp_path_factory.mktemp("survey") / "site.laz")


@pytest.fixture(scope="module")
def mapped(survey):
    out = survey.parent / "layers"
    result = run("map", survey, "--out", out)
    assert result.exit_code == 0, result.output
    return out


@pytest.fixture
def viewed(mapped, tmp_path):
    """A copy of the layers as QGIS leaves them."""
    out = shutil.copytree(mapped, tmp_path / "viewed")
    for name in VIEW_NAMES:
        if (out / name).suffix in {".qml", ".qgs"}:
            (out / name).write_text("<qgis/>", encoding="utf-8")
    (out / "map.qgs~").write_text("<qgis/>", encoding="utf-8")
    for raster in out.rglob("*.tif"):
        side = raster.with_name(f"{raster.name}.aux.xml")
        if not side.exists():
            side.write_text(STATISTICS, encoding="utf-8")
    return out


def test_the_same_run_again_has_nothing_to_do(survey, viewed):
    before = files_in(viewed)
    result = run("map", survey, "--out", viewed, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout.splitlines()[-1])["already_done"]
    assert files_in(viewed) == before
    for name in VIEW_NAMES:  # deleted views are not missed
        (viewed / name).unlink(missing_ok=True)
    assert json.loads(run("map", survey, "--out", viewed, "--json").stdout.splitlines()[-1])["already_done"]


def test_overwriting_brings_the_styles_back(survey, mapped, viewed):
    result = run("map", survey, "--out", viewed, "--overwrite")
    assert result.exit_code == 0, result.output
    for name in ("rasters/class.qml", "map.qgs"):
        assert (viewed / name).read_bytes() == (mapped / name).read_bytes()
    assert not (viewed / "rasters/roughness.tif.aux.xml").exists()
