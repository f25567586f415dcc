from pathlib import Path

import pytest

from bumpymap.core.config import FeatureSettings, MapConfig
from bumpymap.core.errors import UsageError
from bumpymap.core.settings_file import read_settings_file


def test_defaults_need_no_file():
    config = MapConfig(surveys=(Path("a.laz"),), out=Path("out"))
    assert (config.tile_size, config.pixels, config.features.min_points) == (3.0, 15, 30)
    assert config.threads >= 1


def test_settings_from_a_file(tmp_path):
    file = tmp_path / "site.toml"
    file.write_text(
        'surveys = ["a.laz"]\nout = "layers"\ncrs = "EPSG:32614"\n'
        'scheduler = "tcp://a:1"\nscratch = "tmp"\n[features]\nmin_points = 50\n'
    )
    config = MapConfig(**read_settings_file(file, MapConfig))
    assert (config.scheduler, config.scratch) == ("tcp://a:1", tmp_path / "tmp")
    assert config.surveys == (tmp_path / "a.laz",)
    assert config.out == tmp_path / "layers"
    assert config.features == FeatureSettings(min_points=50)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tile_sice = 3", "unknown setting tile_sice; there are: .*tile_size"),
        ("[features]\nholes = 2", r"\[features\]: unknown setting holes"),
        ("features = 3", "must be a table"),
        ("tile_size = ", "cannot read settings"),
        ("tile_size = true", "tile_size is True; it must be a number"),
        ("threads = 1.5", "threads is 1.5; it must be a whole number"),
        ("crs = 32614", "crs is 32614; it must be a string"),
        ("calibration = 3", "calibration is 3; it must be a string"),
        ('surveys = "a.laz"', "surveys is 'a.laz'; it must be a list of strings"),
        ("surveys = [1]", "value 1 of surveys is 1; it must be a string"),
        ('ground = "some"', "ground is 'some'; it must be one of auto, all, class, csf"),
        ("local = 1", "local is 1; it must be true or false"),
        ("threads = true", "threads is True; it must be a whole number"),
        ("threads = 0\nscheduler = 3", "scheduler is 3; it must be a string"),
        ("[features]\nmin_points = 2", "min_points is 2; it must be a whole number, at least 3"),
        ('[features]\nmax_hole = "deep"', "max_hole is 'deep'; it must be a number from 0 to 1e\\+06 m"),
        ('tile_size = "3 m"', "tile_size is '3 m'; it must be a number from 0.05 to 1000 m"),
        ('sheets = "50 km"', "sheets is '50 km'; it must be a number from 0.001 to 10000 km"),
        (
            "tile_size = 0\npixels = 2",
            "2 errors.*tile_size is 0; .* 1000 m.*pixels is 2; it must be a whole number from 3",
        ),
    ],
)
def test_a_bad_file_is_refused_with_what_is_allowed(tmp_path, text, message):
    file = tmp_path / "site.toml"
    file.write_text(text)
    with pytest.raises(UsageError, match=message):
        read_settings_file(file, MapConfig)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"tile_size": 0.0}, "tile_size"),
        ({"pixels": 2}, "pixels"),
        ({"threads": 0}, "threads"),
        ({"ground": "some"}, "`ground` is 'some'; it must be one of auto, all, class"),
        ({"z_unit": "yard"}, "z_unit"),
        ({"compat": "other"}, "compat"),
    ],
)
def test_values_out_of_bounds_are_refused(setting, message):
    with pytest.raises(UsageError, match=message):
        MapConfig(surveys=(Path("a.laz"),), out=Path("out"), **setting)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(UsageError, match="cannot read settings"):
        read_settings_file(tmp_path / "none.toml", MapConfig)
