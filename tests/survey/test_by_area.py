"""A survey of which a part was never classified: that part is measured from all points, the other from its ground."""

import json
import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from small_surveys import layers_of, run, write_las

import bumpymap
from bumpymap.survey import Budget

pytestmark = pytest.mark.slow

EAST, NORTH = 500_013.0, 4_000_020.0
SEAM = 52.0
"""m from the west; not a border of tiles."""


def made_site(code, seed=0, size=(108.0, 60.0)):
    """Rolling ground with bushes and a wall across the border of a classified part and one of class ``code``.

    Returns x, y, z [m] and class of each point.
    """
    rng = np.random.default_rng(seed)
    x, y = (np.round(rng.uniform(0.0, side, int(60 * size[0] * size[1])), 3) for side in size)
    z = 0.03 * x + 0.3 * np.sin(x / 9.0) + rng.normal(0.0, 0.01, len(x))
    bush = ((x // 6 + y // 6) % 3 == 0) & (rng.random(len(x)) < 0.2)
    wall = (np.abs(y - 31.0) < 0.4) & (x > 20.0) & (x < 80.0)
    z += np.where(wall, 1.5, np.where(bush, rng.uniform(0.0, 1.0, len(x)), 0.0))
    classes = np.where(x > SEAM, code, np.where(wall | bush, 1, 2))
    return np.column_stack([x, y, np.round(z, 3), classes])


def write(path, points):
    x, y, z, classes = points.T
    return write_las(path, EAST + x, NORTH + y, z, classification=classes.astype(np.uint8))


def mapped(surveys, out, *options):
    result = run("map", *surveys, "--out", out, "--quiet", *options)
    assert result.exit_code == 0, result.output
    return json.loads((out / "run.json").read_text()), pq.read_table(out / "tiles.parquet").drop(["bbox", "geometry"])


def same(one, other, chosen):
    """Whether the chosen rows of two tables are the same, in the columns of the second."""
    rows = [table.filter(pa.array(chosen)) for table in (one.select(other.column_names), other)]
    heights = [np.stack(each["heights"].to_numpy()) for each in rows]
    frames = [each.drop(["heights"]).to_pandas() for each in rows]
    return np.array_equal(*heights, equal_nan=True) and frames[0].equals(frames[1])


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """Layers of the site as it comes, of class 1 in the east, and of all and of ground points alone."""
    folder = tmp_path_factory.mktemp("mixed")
    survey = write(folder / "site.laz", made_site(1))
    return folder, {kind: mapped([survey], folder / kind, "--ground", kind) for kind in ("auto", "all", "class")}


def test_each_part_is_rated_as_if_it_were_the_whole_survey(mixed):
    folder, found = mixed
    record, table = found["auto"]
    from_seam = 3.0 * table["col"].to_numpy() + 1.5 - EAST - SEAM
    source = table["ground_source"].to_numpy()
    assert np.array_equal(source[np.abs(from_seam) > 3.0], (from_seam > 0)[np.abs(from_seam) > 3.0])
    assert record["tiles_from_all_points"] == source.sum()
    known = table["class"].is_valid().to_numpy(zero_copy_only=False)
    assert known[np.abs(from_seam) < 3.0].mean() > 0.9
    dense = table["coverage"].to_numpy() > 0.8  # the noise of thin tiles is that of their whole block
    assert same(table, found["all"][1], dense & (from_seam > 6.0))
    assert same(table, found["class"][1], dense & (from_seam < -6.0))
    assert not same(table, found["class"][1], dense & (from_seam > 6.0))
    told = run("map", folder / "site.laz", "--out", folder / "auto").output
    assert f"measured from ground points, {source.sum()} from all points: that part of the survey is not c" in told
    assert "ground_source" not in found["all"][1].column_names + found["class"][1].column_names
    told = " ".join(run("info", folder / "site.laz").output.split())
    about, of = map(int, re.search(r"about (\d+) tiles of (\d+) are of a part that is not classified", told).groups())
    assert (of, about) == (len(source), pytest.approx(source.sum(), rel=0.06))


def test_no_way_leads_over_the_wall_that_stands_on_both_sides_of_the_border(mixed):
    table = mixed[1]["auto"][1]
    x, y = (3.0 * table[axis].to_numpy() + 1.5 - first for axis, first in (("col", EAST), ("row", NORTH)))
    at_wall = (np.abs(y - 31.0) < 1.5) & (x > 24.0) & (x < 76.0)
    passable = table["passable"].to_numpy(zero_copy_only=False)
    assert at_wall.sum() >= 17
    crossed = passable[at_wall] & (np.stack([table[f"step_{side}"].to_numpy() for side in ("north", "south")]) < 0.2)[
        :, at_wall
    ].all(axis=0)
    assert not crossed.any()
    assert passable[np.abs(y - 31.0) > 6.0].mean() > 0.5


@pytest.mark.parametrize("tight", [False, True])
def test_neither_files_nor_budget_change_a_byte_of_it(mixed, tmp_path, monkeypatch, tight):
    points = np.random.default_rng(1).permutation(made_site(1))
    halves = [points[points[:, 0] <= SEAM], points[points[:, 0] > SEAM]] if tight else [points[::2], points[1::2]]
    for number, half in enumerate(halves):
        write(tmp_path / "files" / f"{number}.las", half)
    if tight:
        for name, most in (("chunk", 20_000), ("waiting", 60_000), ("block", 40_000)):
            monkeypatch.setattr(Budget, f"{name}_points", most)
    record, table = mapped([tmp_path / "files"], tmp_path / "out")
    whole, expected = mixed[1]["auto"]
    assert same(table, expected, np.ones(len(expected), bool))
    assert record["counts"] == whole["counts"]
    assert record["tiles_from_all_points"] == whole["tiles_from_all_points"]


@pytest.mark.parametrize("place", ["decide_ground", "save_joined", "MeasuredTiles.of"])
def test_a_run_killed_on_the_way_goes_on(mixed, tmp_path, monkeypatch, place):
    folder, _ = mixed

    def killed(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(Budget, "chunk_points", 40_000)
    monkeypatch.setattr(Budget, "waiting_points", 100_000)
    with monkeypatch.context() as patch:
        patch.setattr(f"bumpymap.survey.engine.run.{place}", killed)
        assert run("map", folder / "site.laz", "--out", tmp_path / "out").exit_code == 130
    assert run("map", folder / "site.laz", "--out", tmp_path / "out").exit_code == 0
    assert layers_of(tmp_path / "out") == layers_of(folder / "auto")


def test_where_most_was_never_classified_the_rest_is_still_measured_from_its_ground(tmp_path):
    points = made_site(0)
    points[points[:, 0] > 30.0, 3] = 0
    record, table = mapped([write(tmp_path / "site.laz", points)], tmp_path / "out")
    assert record["ground_only"]
    assert 0.6 < record["tiles_from_all_points"] / len(table) < 0.8


def test_roofs_water_and_woods_in_a_classified_survey_are_no_ground(tmp_path):
    """A roof of 20 m, a pond without points and a wood of 36 m at the edge, all of class 1 without ground below."""
    x, y, z, classes = made_site(2).T
    classes[(classes == 2) & (x > SEAM)] = 2
    roof, pond, wood = (x > 20) & (x < 40) & (y > 34) & (y < 54), (x > 10) & (x < 30) & (y < 16), x > 72
    z, classes = z + np.where(roof, 5.0, np.where(wood, 6.0, 0.0)), np.where(roof | wood, 1, classes)
    survey = write(tmp_path / "site.laz", np.column_stack([x, y, z, classes])[~pond])
    record, table = mapped([survey], tmp_path / "auto")
    mapped([survey], tmp_path / "class", "--ground", "class")
    assert record["ground_only"]
    assert "tiles_from_all_points" not in record
    assert layers_of(tmp_path / "auto") == layers_of(tmp_path / "class")
    east = 3.0 * table["col"].to_numpy() - EAST
    north = 3.0 * table["row"].to_numpy() - NORTH
    inside = (east > 73) | ((east > 20) & (east < 37) & (north > 34) & (north < 51))
    assert inside.sum() > 200
    assert set(np.array(table["reason_text"])[inside]) == {"no ground points"}
    assert bumpymap.open(tmp_path / "auto").tiles()["class"][inside].isna().all()
