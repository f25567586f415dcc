"""Tiles of another size need a calibration that drove over such patches, and a texture network only for the table."""

from dataclasses import replace
from pathlib import Path

import pytest

from bumpymap.core import INCLUDED_PIXELS, MapConfig, UsageError, with_pixels
from bumpymap.rating import Calibration, RideModel
from bumpymap.rating.calibration import shipped_calibrations
from bumpymap.survey.tile_rating import RatingModels


def loaded(folder, **settings):
    return RatingModels.load(MapConfig((Path("a.laz"),), folder, **settings))


def test_what_tiles_of_another_size_need(tmp_path):
    with pytest.raises(
        UsageError, match=r"bumpymap calibrate --vehicle warthog --tile-size 1\.5 --set pixels=15 --out my"
    ):
        loaded(tmp_path, tile_size=1.5)
    own = tmp_path / "own.json"
    own.write_text(replace(Calibration.shipped("warthog"), tile_size=1.5).to_json())
    models = loaded(tmp_path, tile_size=1.5, calibration=own)
    assert (models.texture, models.texture_id) == (None, None)
    for setting in ({"rating": "table"}, {"compat": "paper"}):
        with pytest.raises(UsageError, match=r"bumpymap train textures --set tile_size=1\.5"):
            loaded(tmp_path, tile_size=1.5, calibration=own, **setting)
    assert loaded(tmp_path).texture.tile_size == 3.0


@pytest.mark.parametrize("name", shipped_calibrations())
def test_included_vehicles_are_calibrated_for_three_sizes_with_one_meaning_of_the_classes(tmp_path, name):
    found = [loaded(tmp_path, vehicle=name, **with_pixels({"tile_size": size})).calibration for size in INCLUDED_PIXELS]
    assert [(each.tile_size, each.pixels) for each in found] == list(INCLUDED_PIXELS.items())
    assert len({each.class_limits for each in found}) == 1
    for each in found:
        assert each.tile_size / each.pixels == pytest.approx(0.2)
        assert RideModel(each).correction.origin["spearman"] > 0.94
        assert each.thin["prior"]
        limits = (0.0, *each.class_limits, float("inf"))
        assert all(low <= mean < high for low, mean, high in zip(limits, each.class_c_r, limits[1:], strict=False))
