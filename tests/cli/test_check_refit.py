"""``bumpymap check --refit``: which calibration is moved, where it is written, what is said."""

import json

import pytest
from driven_stretches import driven_stretches
from small_surveys import write_survey

from bumpymap.api import map_survey
from bumpymap.cli.check_command import prepare_refit
from bumpymap.core import BadInputError, OutputError, UsageError
from bumpymap.rating import Calibration

CALIBRATION = Calibration.shipped("warthog")


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    map_survey(write_survey(folder / "site.laz"), folder / "layers")
    return folder / "layers"


def test_the_calibration_of_the_map_is_moved_and_written(layers, tmp_path):
    out = tmp_path / "new" / "my_robot.json"
    refit = prepare_refit(layers, None, out, overwrite=False)
    update = refit.move(driven_stretches(CALIBRATION, 50, shift=0.3), 1.0)
    assert Calibration.load(out).settings["moved_to_drives"]["calibration_id"] == CALIBRATION.id
    assert [path.name for path in out.parent.iterdir() if not path.name.startswith(".")] == ["my_robot.json"]
    said = "\n".join(refit.lines(update))
    assert "500 m of driving on 50 stretches, 500 m of it on different ground: this vehicle pitches 3" in said
    assert f"--calibration {out}" in said
    assert json.dumps(refit.record(update))


def test_a_map_of_larger_tiles_has_its_own_calibration(tmp_path):
    map_survey(write_survey(tmp_path / "site.laz"), tmp_path / "layers", tile_size=5)
    refit = prepare_refit(tmp_path / "layers", None, tmp_path / "moved.json", overwrite=False)
    own = Calibration.shipped("warthog", 5.0)
    refit.move(driven_stretches(own, 50, shift=0.3), 1.0)
    assert Calibration.load(tmp_path / "moved.json").settings["moved_to_drives"]["calibration_id"] == own.id


def test_drives_that_are_refused_write_nothing(layers, tmp_path):
    out = tmp_path / "my_robot.json"
    refit = prepare_refit(layers, None, out, overwrite=False)
    with pytest.raises(BadInputError, match="too short"):
        refit.move(driven_stretches(CALIBRATION, 5), 1.0)
    assert not out.exists()


@pytest.mark.parametrize("content", ["time,gyro_y\n", "{}", '{"format": "bumpymap-run"}', ""])
def test_what_is_no_calibration_is_not_replaced(layers, tmp_path, content):
    out = tmp_path / "drive.csv"
    out.write_text(content)
    with pytest.raises(OutputError, match="is no calibration, and was not touched"):
        prepare_refit(layers, None, out, overwrite=True)
    assert out.read_text() == content


def test_a_file_that_exists_is_replaced_only_if_asked(layers, tmp_path):
    out = tmp_path / "my_robot.json"
    out.write_text(Calibration.shipped("car").to_json(), encoding="utf-8")
    with pytest.raises(OutputError, match="exists; give `overwrite=True`"):
        prepare_refit(layers, None, out, overwrite=False)
    prepare_refit(layers, None, out, overwrite=True).move(driven_stretches(CALIBRATION, 50), 1.0)
    assert Calibration.load(out).id != CALIBRATION.id
    link = tmp_path / "link.json"
    link.symlink_to(tmp_path / "elsewhere.json")
    with pytest.raises(OutputError, match="exists"):
        prepare_refit(layers, None, link, overwrite=False)
    with pytest.raises(OutputError, match="is a folder"):
        prepare_refit(layers, None, tmp_path, overwrite=True)


def test_a_map_is_needed_and_its_own_calibration(layers, tmp_path):
    with pytest.raises(UsageError, match="give the folder of the map"):
        prepare_refit(None, None, tmp_path / "a.json", overwrite=False)
    other = tmp_path / "rover.json"
    other.write_text(Calibration.shipped("small_rover").to_json(), encoding="utf-8")
    with pytest.raises(BadInputError, match=f"made with the calibration {CALIBRATION.id} of warthog"):
        prepare_refit(layers, other, tmp_path / "a.json", overwrite=False)


def test_a_calibration_that_is_gone_is_asked_for(tmp_path):
    own = tmp_path / "mine.json"
    own.write_text(CALIBRATION.to_json(), encoding="utf-8")
    map_survey(write_survey(tmp_path / "site.laz"), tmp_path / "layers", calibration=own)
    moved = own.rename(tmp_path / "moved.json")
    with pytest.raises(UsageError, match=r"is not found .* Give its file with `calibration`"):
        prepare_refit(tmp_path / "layers", None, tmp_path / "a.json", overwrite=False)
    assert (
        prepare_refit(tmp_path / "layers", moved, tmp_path / "a.json", overwrite=False).calibration.id == CALIBRATION.id
    )


def test_a_map_at_another_speed_is_refused_since_the_drives_of_the_calibration_had_their_own(tmp_path):
    map_survey(write_survey(tmp_path / "site.laz"), tmp_path / "fast", speed=1.5)
    with pytest.raises(BadInputError, match=r"made for 1\.5 m/s.*drives at 1 m/s"):
        prepare_refit(tmp_path / "fast", None, tmp_path / "a.json", overwrite=False)
