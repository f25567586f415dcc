"""Maps in sheets from surveys: the same tiles, resumed after a kill, told apart from other runs."""

import json

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from small_surveys import write_las, write_survey

import bumpymap
from bumpymap.cli import main
from bumpymap.layers import placement, sheets as writing, write_products

SIDE = 0.096
"""km: two blocks of 16 tiles of 3 m."""
RASTERS = ("roughness", "class", "cost", "barred", "heightmap", "obstacle")


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return write_survey(tmp_path_factory.mktemp("survey") / "site.laz", side=110.0, points=30_000)


@pytest.fixture(scope="module")
def whole(survey, tmp_path_factory):
    return bumpymap.map_survey(survey, tmp_path_factory.mktemp("whole") / "out")


@pytest.fixture(scope="module")
def sheets(survey, tmp_path_factory):
    return bumpymap.map_survey(survey, tmp_path_factory.mktemp("sheets") / "out", sheets=SIDE)


def assert_same_pixels(folder, whole):
    for name in RASTERS:
        with rasterio.open(whole / f"{name}.tif") as one, rasterio.open(folder / f"{name}.vrt") as several:
            pixels = one.read()
            assert np.array_equal(several.read(), pixels, equal_nan=pixels.dtype.kind == "f"), name


def test_tiles_at_borders_of_sheets_are_judged_with_their_neighbours(whole, sheets):
    assert len(sheets.sheets) >= 4
    assert_same_pixels(sheets.folder, whole.folder)
    assert sheets.manifest["counts"] == whole.manifest["counts"]
    with rasterio.open(sheets.folder / "roughness.vrt") as file:
        steps = file.read(file.descriptions.index("edge_step") + 1)
    assert np.isfinite(steps).all()


def test_a_run_that_is_killed_while_it_writes_goes_on(survey, whole, tmp_path, monkeypatch):
    out, written = tmp_path / "out", []

    def stop(table, sheet, **options):
        if len(written) == 2:
            raise KeyboardInterrupt
        written.append(sheet)
        return write_products(table, sheet, **options)

    with monkeypatch.context() as patch:
        patch.setattr(writing, "write_products", stop)
        with pytest.raises(KeyboardInterrupt):
            bumpymap.map_survey(survey, out, sheets=SIDE)
    before = {sheet: (sheet / "run.json").stat().st_ino for sheet in written}
    assert not (out / "run.json").exists()
    with pytest.raises(bumpymap.UsageError, match=r"sheets was 0\.096, is 0\.048"):
        bumpymap.map_survey(survey, out, sheets=0.048)
    done = bumpymap.map_survey(survey, out, sheets=SIDE)
    assert {sheet: (sheet / "run.json").stat().st_ino for sheet in written} == before
    assert len(done.sheets) > len(written)
    assert_same_pixels(out, whole.folder)
    assert not (out / ".bumpymap-run").exists()


def test_a_complete_map_is_known_again(survey, sheets):
    out = sheets.folder
    stamp = (out / "run.json").stat().st_mtime_ns
    bumpymap.map_survey(survey, out, sheets=SIDE)
    assert (out / "run.json").stat().st_mtime_ns == stamp
    for settings, told in (({"sheets": 0.048}, "sheets was 0.096, is 0.048"), ({}, "sheets was 0.096, is not given")):
        with pytest.raises(bumpymap.OutputError) as caught:
            bumpymap.map_survey(survey, out, **settings)
        assert told in " ".join(map(str, caught.value.args))


@pytest.mark.slow
def test_damage_to_a_sheet_is_noticed_and_a_map_replaces_sheets(survey, whole, tmp_path):
    out = tmp_path / "out"
    done = bumpymap.map_survey(survey, out, sheets=SIDE)
    (done.sheets[1] / "cost.tif").write_bytes(b"")
    with pytest.raises(bumpymap.OutputError, match=r"cost.tif has changed since"):
        bumpymap.map_survey(survey, out, sheets=SIDE)
    bumpymap.map_survey(survey, out, overwrite=True)
    present = {path.name for path in out.iterdir() if not path.name.startswith(".")}
    assert present == {path.name for path in whole.folder.iterdir() if not path.name.startswith(".")}


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{}, {"sheets": SIDE}], ids=["one map", "sheets"])
def test_the_output_folder_may_be_a_link(survey, whole, tmp_path, settings):
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    bumpymap.map_survey(survey, tmp_path / "out", **settings)
    done = bumpymap.map_survey(survey, tmp_path / "out", overwrite=True)
    assert (tmp_path / "out").is_symlink()
    present = {path.name for path in (tmp_path / "disk").iterdir() if not path.name.startswith(".")}
    assert present == {path.name for path in whole.folder.iterdir() if not path.name.startswith(".")}
    assert done.manifest["counts"] == whole.manifest["counts"]


def test_a_sheet_names_the_files_that_it_was_made_from(tmp_path):
    for number, east in enumerate((500_010.0, 501_010.0)):
        _write_points(tmp_path / "site" / f"part_{number}.las", np.array([east]), 4_000_002.0)
    done = bumpymap.map_survey(tmp_path / "site", tmp_path / "out", sheets=0.48)
    named = [
        [entry["path"].rpartition("/")[2] for entry in bumpymap.open(sheet).manifest["inputs"]] for sheet in done.sheets
    ]
    assert sorted(named) == [["part_0.las"], ["part_1.las"]]
    assert len(done.manifest["inputs"]) == 2


def test_sheets_need_a_folder(survey):
    with pytest.raises(bumpymap.UsageError, match="give `out='DIR'`"):
        bumpymap.map_survey(survey, sheets=SIDE)


def test_a_site_too_large_for_one_map_is_told_of_sheets(survey, tmp_path, monkeypatch):
    monkeypatch.setattr(placement, "MAX_TILES", 100)
    with pytest.raises(bumpymap.BadInputError, match=r"in sheets with `sheets=5`.*site.laz"):
        bumpymap.map_survey(survey, tmp_path / "out")


def _write_points(path, east, north):
    """A square of points around each easting."""
    spread = np.random.default_rng(0).uniform(0, 2, (len(east), 200, 2))
    x, y = (east[:, None] + spread[..., 0]).ravel(), (north + spread[..., 1]).ravel()
    write_las(path, x, y, np.full(x.shape, 7.0))


@pytest.mark.parametrize("quick", [[], ["--quick"]])
def test_info_says_that_a_site_needs_sheets(tmp_path, quick):
    """40 km x 40 km."""
    _write_points(tmp_path / "south.las", np.array([500_010.0, 540_010.0]), 4_000_002.0)
    _write_points(tmp_path / "north.las", np.array([500_010.0]), 4_040_002.0)
    both = CliRunner().invoke(main, ["info", str(tmp_path), *quick])
    assert "one map: bumpymap map" in both.output
    assert "--sheets 5 --out DIR" in both.output
    assert "--sheets 5 writes it in several folders" in both.output
    told = json.loads(CliRunner().invoke(main, ["info", str(tmp_path), *quick, "--json"]).stdout)
    assert told["sheets_km"] == 5
    assert [file["sheets_km"] for file in told["files"]] == [None, None]
    one = CliRunner().invoke(main, ["info", str(tmp_path / "south.las"), *quick])
    assert "--sheets" not in one.output
