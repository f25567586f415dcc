"""Tiles of another size need a calibration that drove over such patches, and a texture network only for the table."""

from dataclasses import replace
from pathlib import Path

import pytest

from bumpymap.core import MapConfig, UsageError
from bumpymap.rating import Calibration
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
