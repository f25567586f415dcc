"""The folder of a check: all files or none, nothing replaced that was not meant, no link followed; and read again."""

import hashlib
import json
from dataclasses import fields, replace

import numpy as np
import pytest
from check_records import made_up_check
from hypothesis import given, settings, strategies as st
from route_records import MadeUpMap

from bumpymap.check.pipeline import write_check
from bumpymap.core import BadInputError, CheckedDrive, OutputError, UsageError
from bumpymap.layers import check_check_out
from bumpymap.layers.check_record import (
    CHECK_FILES,
    CHECK_MANIFEST_NAME,
    check_entries,
    read_check,
    result_of,
)

ALL = sorted(CHECK_FILES.names)
WITHOUT_MAP = ["check.html", "check.json"]
SETTINGS = {"settings": {"band_hz": 10.0, "window_m": 10.0}}
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.fixture(scope="module")
def ground():
    return MadeUpMap.around()


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def same(one, other):
    """Whether two records are equal; NaN equals NaN, arrays by type and value."""
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if isinstance(one, float):
        return one == other or (np.isnan(one) and np.isnan(other))
    if hasattr(one, "__dataclass_fields__"):
        return type(one) is type(other) and all(
            same(getattr(one, field.name), getattr(other, field.name)) for field in fields(one)
        )
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other


def test_a_folder_gets_every_file_and_the_manifest(ground, tmp_path):
    out = tmp_path / "new" / "checked"
    check_check_out(out, overwrite=False)
    assert not out.exists()
    files = write_check(made_up_check(), out, ground=ground, manifest=SETTINGS)
    assert names(out) == ALL == sorted(path.name for path in files)
    record = json.loads((out / CHECK_MANIFEST_NAME).read_text())
    assert record["format"] == "bumpymap-check"
    assert record["settings"] == SETTINGS["settings"]
    assert record["calibration"] == {"id": "c0ffee"}
    assert record["crs"]["code"] == "EPSG:32614"
    assert "bumpymap" in record["versions"]
    listed = [entry["path"] for entry in record["files"]]
    assert listed == ["check.html", "check.geojson"]
    for entry in record["files"]:
        content = (out / entry["path"]).read_bytes()
        assert (entry["bytes"], entry["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
    for again in write_check(made_up_check(), tmp_path / "again", ground=ground, manifest=SETTINGS):
        assert again.read_bytes() == (out / again.name).read_bytes()


def test_the_layers_are_named_with_their_checksum(ground, tmp_path):
    (tmp_path / "run.json").write_text("{}")
    source = replace(ground, folder=tmp_path)
    write_check(made_up_check(), tmp_path / "out", ground=source)
    (entry,) = json.loads((tmp_path / "out" / "check.json").read_text())["layers"]
    assert entry == {"path": str(tmp_path), "run_sha256": hashlib.sha256(b"{}").hexdigest()}


@pytest.mark.parametrize("has_map", [True, False])
def test_without_a_map_or_positions_there_is_nothing_for_gis(ground, tmp_path, has_map):
    result, nowhere = made_up_check(ground=has_map), np.full(40, np.nan)
    result = replace(result, stretches=replace(result.stretches, easting=nowhere, northing=nowhere))
    write_check(result, tmp_path, ground=ground if has_map else None)
    assert names(tmp_path) == WITHOUT_MAP
    record = json.loads((tmp_path / "check.json").read_text())
    assert [bool(record[name]) for name in ("map", "agreement", "by_class")] == [has_map] * 3


def test_files_of_an_earlier_check_are_replaced_only_if_asked_and_none_is_left(ground, tmp_path):
    write_check(made_up_check(), tmp_path, ground=ground)
    before = (tmp_path / "check.json").read_bytes()
    with pytest.raises(OutputError, match=r"already holds check\.html.*overwrite=True"):
        write_check(made_up_check(seed=6), tmp_path, ground=ground)
    with pytest.raises(OutputError, match="already holds"):
        check_check_out(tmp_path, overwrite=False)
    assert (tmp_path / "check.json").read_bytes() == before
    (tmp_path / "my notes.txt").write_text("mine")
    write_check(made_up_check(seed=6), tmp_path, ground=ground, overwrite=True)
    assert (tmp_path / "check.json").read_bytes() != before
    write_check(made_up_check(ground=False), tmp_path, overwrite=True)
    assert names(tmp_path) == [*WITHOUT_MAP, "my notes.txt"]


def test_the_folder_of_a_map_and_files_are_refused(ground, tmp_path):
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(UsageError, match="holds the layers of a survey"):
        write_check(made_up_check(), tmp_path, ground=ground, overwrite=True)
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="it is a file"):
        check_check_out(tmp_path / "file", overwrite=True)
    with pytest.raises(UsageError, match=r"named like a \.json file, but a check is a folder"):
        check_check_out(tmp_path / "check.json", overwrite=False)
    (tmp_path / "other" / "check.html").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"check\.html is not a file"):
        check_check_out(tmp_path / "other", overwrite=True)


@pytest.mark.parametrize("options", [{}, {"ground": False}, {"unknown": [0, 3]}, {"drives": 3}])
def test_what_was_written_is_read_again(ground, tmp_path, options):
    result = made_up_check(**options)
    write_check(result, tmp_path, ground=ground if result.ground else None, manifest=SETTINGS)
    for place in (tmp_path, tmp_path / "check.json"):
        found, record = read_check(place)
        assert same(found, result)
        assert record["settings"] == SETTINGS["settings"]


@settings(max_examples=25)
@given(st.data())
def test_numbers_that_are_not_known_come_back(data):
    result = made_up_check(6)
    number = st.one_of(st.just(float("nan")), st.floats(-1e6, 1e6))
    plain = [field.name for field in fields(CheckedDrive) if field.type in {float, "float"}]
    drive = replace(
        result.drives[0],
        **{name: data.draw(number) for name in plain},
        mount_deg=tuple(data.draw(number) for _ in range(3)),
        name=data.draw(st.text()),
    )
    stretches = replace(result.stretches, measured=np.array([data.draw(number) for _ in range(6)]))
    changed = replace(result, drives=(drive,), stretches=stretches)
    text = json.dumps(check_entries(changed), allow_nan=False)
    assert same(result_of(json.loads(text)), changed)


@pytest.mark.parametrize(
    "damage",
    [
        lambda record: record.update(format="bumpymap-route"),
        lambda record: record.pop("stretches"),
        lambda record: record["stretches"]["c_r"].pop(),
        lambda record: record["stretches"]["drive"].__setitem__(0, 9),
        lambda record: record["stretches"]["class_id"].__setitem__(0, 17),
        lambda record: record["drives"][0].pop("mount_deg"),
        lambda record: record.update(agreement=[]),
        lambda record: record["map"].update(class_limits=[0.1]),
        lambda record: record["stretches"]["drive"].__setitem__(0, 10**30),
        lambda record: record["stretches"]["measured"].__setitem__(0, float("1e308")),
        lambda record: record["agreement"].update(stretches=1e999),
        lambda record: record.update(warnings="off"),
    ],
)
def test_a_damaged_record_is_refused(ground, tmp_path, damage):
    write_check(made_up_check(), tmp_path, ground=ground)
    path = tmp_path / "check.json"
    record = json.loads(path.read_text())
    damage(record)
    path.write_text(json.dumps(record).replace("Infinity", "1e999"))
    with pytest.raises(BadInputError, match=r"check\.json.*Give the folder that `bumpymap check` wrote"):
        read_check(tmp_path)


@pytest.mark.parametrize("content", [None, "", "[]", '{"format": "bumpymap-check"}', "[" * 100_000, "\udcff"])
def test_a_file_that_is_no_check(tmp_path, content):
    if content is not None:
        (tmp_path / "check.json").write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(BadInputError, match=r"check\.json"):
        read_check(tmp_path)
