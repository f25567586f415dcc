"""Tiles of another size need a calibration that drove over such patches, and a texture network only for the table."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bumpymap.core import MapConfig, UsageError
from bumpymap.rating import Calibration
from bumpymap.survey.tile_rating import RatingModels

SURVEY = (Path("a.laz"),)


@pytest.fixture(name="own")
def own_calibration(tmp_path):
    file = tmp_path / "own.json"
    file.write_text(replace(Calibration.shipped("warthog"), tile_size=1.5).to_json())
    return file


def test_the_ride_model_does_without_a_network(own, tmp_path):
    models = RatingModels.load(MapConfig(SURVEY, tmp_path, tile_size=1.5, calibration=own))
    assert models.texture is None
    assert models.texture_id is None


@pytest.mark.parametrize("setting", [{"rating": "table"}, {"compat": "paper"}])
def test_the_table_wants_a_network(own, setting, tmp_path):
    with pytest.raises(UsageError, match=r"bumpymap train textures --set tile_size=1\.5"):
        RatingModels.load(MapConfig(SURVEY, tmp_path, tile_size=1.5, calibration=own, **setting))


def test_what_a_missing_calibration_needs_is_told(tmp_path):
    with pytest.raises(
        UsageError, match=r"bumpymap calibrate --vehicle warthog --tile-size 1\.5 --set pixels=15 --out my"
    ):
        RatingModels.load(MapConfig(SURVEY, tmp_path, tile_size=1.5))


def test_shipped_tiles_have_a_texture(tmp_path):
    assert np.isfinite(RatingModels.load(MapConfig(SURVEY, tmp_path)).texture.tile_size)
