"""The same points give the same bytes in every file: split, ordered, read in chunks or spilled."""

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from alike_surveys import alike_surveys
from hypothesis import HealthCheck, given, settings, strategies as st
from small_surveys import SIDES, files_in, run, write_las

from bumpymap.layers.products import PRODUCT_NAMES, VIEW_NAMES, MapFile

pytestmark = pytest.mark.slow

CORNER = np.array([500_013.0, 4_000_020.0, 300.0])
"""Not a corner of a block, so that files and blocks overlap anyhow."""
SPAN = (130.0, 70.0)
"""Some three by two blocks of 48 m."""
OF_THE_CALL = {"surveys", "out", "scratch"}

NAMING = {"run.json", "report.html"}
"""Files that name the files of the survey and the settings."""


@pytest.fixture(scope="module")
def points():
    """Rough ground under bushes, on a grid of 1 mm, with points that occur twice; x, y, z, class."""
    rng = np.random.default_rng(0)
    n = 40_000
    x, y = rng.uniform(0, SPAN[0], n), rng.uniform(0, SPAN[1], n)
    bush = rng.random(n) < 0.3
    z = 0.1 * x + 0.8 * np.sin(5 * x) * (x > 60) + 0.01 * rng.normal(size=n) + bush * rng.uniform(0, 2, n)
    cloud = np.column_stack([np.round(x, 3), np.round(y, 3), np.round(z, 3), np.where(bush, 5, 2)])
    return np.concatenate([cloud, cloud[:500]])


def colours(points):
    """Colours of points, 8 bits a channel, (n, 3): smooth over the ground, and darker below; a few points have none."""
    x, y, z = points[:, :3].T
    shade = np.clip(0.6 + 0.1 * (z - 0.1 * x), 0.3, 1.0)[:, None]
    found = np.rint(shade * np.column_stack([40 + x, 90 + y, 200 - x])).astype(int)
    return np.where((points[:, :1] * 1000 % 50 < 1), 0, found)


def write(path, points, offset, bits=16):
    """Write points, with colours of 16 bits, or of 8 in the same fields."""
    kind = points[:, 3].astype(np.uint8)
    rgb = dict(zip(("red", "green", "blue"), colours(points).T * (257 if bits == 16 else 1), strict=True))
    return write_las(path, *(points[:, :3] + CORNER).T, offset=offset, classification=kind, **rgb)


def mapped(files, out, *options):
    with alike_surveys():
        result = run("map", *files, "--out", out, *options)
    assert result.exit_code == 0, result.output
    content = files_in(out)
    assert set(content) == {*PRODUCT_NAMES, MapFile.PHOTO, *VIEW_NAMES, *SIDES}
    content = {name: content[name] for name in content if name not in NAMING}
    record = json.loads((out / "run.json").read_text())
    record["files"] = [file for file in record["files"] if file["path"] != "item.json"]  # it names the survey
    settings_of_the_map = {name: value for name, value in record["settings"].items() if name not in OF_THE_CALL}
    kept = {name: value for name, value in record.items() if name not in {"inputs", "seconds", "settings"}}
    return content, kept | {"settings": settings_of_the_map}


@pytest.fixture(scope="module")
def whole(points, tmp_path_factory):
    """What one LAZ file gives that fits into memory, for each way to choose points."""
    folder = tmp_path_factory.mktemp("whole")
    survey = write(folder / "a.laz", points, CORNER)
    found = {ground: mapped([survey], folder / ground, "--ground", ground) for ground in ("auto", "all")}
    (auto, record), (everything, _) = found.values()
    # The property below would hold little were the two the same, or the site all of one kind.
    assert auto["rasters/roughness.tif"] != everything["rasters/roughness.tif"]
    assert sum(count > 0 for count in record["counts"]["by_class"].values()) > 1
    return found


def delivered(points, folder, rng):
    """Write the files of a delivery: how many, split at random or along an axis; return them as they are named."""
    count, axis, offsets = rng.integers(1, 6), rng.integers(3), [(400_000, 3_500_000, 0), (123_456.789, 3_900_000, 17)]
    if rng.random() < 0.5:
        points = rng.permutation(points)
    if axis == 2:
        file = rng.integers(count, size=len(points))
    else:
        file = np.minimum(points[:, axis] / SPAN[axis] * count, count - 1).astype(int)
    names = [f"{n}.{rng.choice(['las', 'laz'])}" for n in range(count)]
    paths = [
        write(folder / name, points[file == n], offsets[rng.integers(2)], rng.choice([8, 16]))
        for n, name in enumerate(names)
    ]
    return [paths[number] for number in rng.permutation(count)]


@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**6), ground=st.sampled_from(["auto", "all"]))
def test_no_delivery_and_no_budget_changes_a_byte(points, whole, tmp_path_factory, limit_points, seed, ground):
    folder, rng = tmp_path_factory.mktemp("delivery"), np.random.default_rng(seed)
    files = delivered(points, folder, rng)
    ranges = {"chunk": (2_000, 60_000), "waiting": (8_000, 80_000), "block": (5_000, 40_000)}
    limit_points(**{name: int(rng.integers(*bounds)) for name, bounds in ranges.items()})
    options = ("--ground", ground, "--threads", rng.integers(1, 4), "--set", f"scratch={folder / 'scratch'}")
    content, record = mapped(files, folder / "layers", *options)
    wanted, wanted_record = whole[ground]
    assert [name for name in wanted if content[name] != wanted[name]] == []
    assert record == wanted_record
    assert list(Path(folder / "scratch").iterdir()) == []


def test_the_photo_shows_the_highest_coloured_point_of_each_pixel(points, whole, tmp_path):
    """Bushes too, from whatever points the ground is measured; JPEG changes the colours a little."""
    (tmp_path / "photo.tif").write_bytes(whole["auto"][0][MapFile.PHOTO])
    assert whole["all"][0][MapFile.PHOTO] == whole["auto"][0][MapFile.PHOTO]
    with rasterio.open(tmp_path / "photo.tif") as file:
        photo, mask, profile, place = file.read(), file.dataset_mask() > 0, file.profile, file.transform
    assert (profile["compress"], profile["count"], place.a) == ("jpeg", 3, 0.2)
    rgb, millimetres = colours(points), np.rint((points[:, :2] + CORNER[:2]) * 1000).astype(int)
    corner = np.array([place.c, place.f - 0.2 * len(mask)])
    col, up = (millimetres // 200 - np.rint(corner / 0.2).astype(int)).T
    wanted = np.full((3, *mask.shape), -1)
    for n in np.argsort(points[:, 2])[rgb.any(axis=1)[np.argsort(points[:, 2])]]:
        wanted[:, len(mask) - 1 - up[n], col[n]] = rgb[n]
    np.testing.assert_array_equal(mask, wanted[0] >= 0)
    assert np.abs(photo - wanted)[:, mask].mean() < 5


@pytest.mark.parametrize(("share", "written"), [(0.0, False), (0.05, False), (0.2, True)])
def test_a_tenth_of_the_points_must_have_a_colour(points, whole, tmp_path, share, written):
    """Without a photo all other layers are the same."""
    rgb = colours(points) * 257 * (np.arange(len(points)) < share * len(points))[:, None]
    columns = dict(zip(("red", "green", "blue"), rgb.T, strict=True))
    survey = write_las(
        tmp_path / "a.laz", *(points[:, :3] + CORNER).T, classification=points[:, 3].astype(int), **columns
    )
    with alike_surveys():
        run("map", survey, "--out", tmp_path / "layers", code=0)
    found = files_in(tmp_path / "layers")
    assert (MapFile.PHOTO in found) == written
    layers = [name for name in PRODUCT_NAMES if name.endswith(".tif") or name == MapFile.TILES]
    assert [name for name in layers if found[name] != whole["auto"][0][name]] == []


def test_only_what_names_the_survey_tells_deliveries_apart(points, tmp_path):
    """The tests above set name, checksum and dates of the survey alike."""
    halves = [write(tmp_path / "two" / f"{n}.laz", points[n::2], CORNER) for n in range(2)]
    one = write(tmp_path / "one.laz", points, CORNER)
    texts = {}
    for name, files in {"two": halves, "one": [one]}.items():
        out = tmp_path / f"{name} layers"
        run("map", *files, "--out", out, code=0)
        survey = json.loads((out / "run.json").read_text())["survey"]
        assert survey["name"] == name
        text = (out / "cost.geojson").read_text()
        for value in (survey["name"], survey["checksum"]):
            assert f'"{value}"' in text
            text = text.replace(f'"{value}"', '""', 1)
        texts[name] = text
    assert texts["one"] == texts["two"]
