"""Methods for scans held against labels: label sets, scores counted by hand, whole runs on a small drive."""

import json
import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from made_drives import churned_field, write_bin
from small_surveys import run

from bumpymap.core import BadInputError, Scan, UsageError
from bumpymap.lab import evaluate as scans
from bumpymap.lab.label_sets import LABEL_SETS, identify_label_set, label_set, require_label_set
from bumpymap.readers import find_frames, read_scan
from bumpymap.scan import classify_filter, polar_sectors

CSV = "id,class,name,kind\n# a remark\n1,0,lawn,ground\n2,2,wall,obstacle\n7,-1,,\n"


def test_the_classes_of_rellis_are_those_of_the_paper():
    rellis = LABEL_SETS["rellis"]
    assert [sorted(k for k, v in rellis.class_of.items() if v == c) for c in range(3)] == [
        [1, 3, 10, 23],
        [6, 19, 31, 33, 34],
        [4, 8, 17, 18, 27],
    ]


@pytest.mark.parametrize("known", LABEL_SETS.values(), ids=str)
def test_a_set_tells_class_ground_and_obstacles_of_its_ids_and_nothing_of_others(known):
    ids = np.array([*known.class_of, 8_000, 65_535], np.uint16)
    assert known.classes_of(ids).tolist() == [*known.class_of.values(), -1, -1]
    assert known.classes_of(np.array([-1])).tolist() == [-1]
    assert set(ids[known.is_ground(ids)]) == known.ground
    assert set(ids[known.is_obstacle(ids)]) == known.obstacle
    assert not known.ground & known.obstacle
    assert set(ids[known.is_known(ids)]) == set(known.class_of)


def test_a_set_from_a_file(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(CSV)
    known = label_set(path)
    assert known == label_set(str(path))
    assert known.class_of == {1: 0, 2: 2, 7: -1}
    assert (known.ground, known.obstacle) == ({1}, {2})


@pytest.mark.parametrize(
    "text",
    [
        *("", "label,class\n1,2\n", "id,class\n", "id,class\n1\n", "id,class\n1,3\n", "id,class\n70000,1\n"),
        *("id,class\n1,0\n1,0\n", "id,class,kind\n1,0,floor\n", "id,class,color\n1,0,red\n", "id,class\n1.5,0\n"),
    ],
)
def test_a_file_that_is_no_set_is_refused(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(BadInputError, match="label set"):
        label_set(tmp_path / "a.csv")
    with pytest.raises(UsageError, match="kitti, semantic-kitti, rellis, or a file"):
        label_set("semantickitti")
    with pytest.raises(BadInputError, match="cannot read"):
        label_set("none/a.csv")


@pytest.mark.parametrize(
    ("labels", "name"),
    [
        ([0, 1, 9, 14, 15, 17, 18], "kitti"),
        ([0, 40, 52, 70, 71, 72, 80], "semantic-kitti"),
        ([0, 3, 4, 19, 33], "rellis"),
    ],
)
def test_the_set_is_told_from_the_ids_and_others_are_refused(labels, name):
    labels = np.array(labels)
    assert identify_label_set(labels, "a.label").name == name
    require_label_set(labels, LABEL_SETS[name], "a.label")
    for other in set(LABEL_SETS) - {name}:
        with pytest.raises(BadInputError, match=f"not those of the set {other}"):
            require_label_set(labels, LABEL_SETS[other], "a.label")


def test_ids_that_exist_in_two_sets_are_told_by_their_ground_and_doubt_is_said():
    assert identify_label_set(np.array([3, 4, 19]), "a").name == "rellis"  # kitti: motorcycles, trucks, signs
    assert identify_label_set(np.array([9, 15, 17]), "a").name == "kitti"  # rellis: objects, logs, persons
    for labels, words in (([10, 18], "fit kitti and rellis; say which"), ([0, 500], "fit no"), ([0, 0], "ids none")):
        with pytest.raises(BadInputError, match=words):
            identify_label_set(np.array(labels), "a.label")


TABLE = scans.ClassedSectorTable(
    class_id={"filter": np.array([0, 0, 1, 2, 2, 2, 255], np.uint8)},
    truth=np.array([0, 1, 1, 2, -1, 0, 2], np.int16),
    traversable=np.array([True] * 6 + [False]),
    deviation=np.array([1.0, 2.0, 2.0, 5.0, 6.0, 1.0, 0.0]),
)


def test_a_sector_without_ground_is_rough_to_a_method_and_one_without_a_label_is_not_judged():
    answers = scans.all_answers(TABLE)
    assert answers["filter"].tolist() == [0, 0, 1, 2, 2, 2, 2]
    assert [answers[f"always {k}"].tolist() for k in range(3)] == [[k] * 7 for k in range(3)]
    assert answers[scans.DEVIATION].tolist() == [0, 1, 1, 2, 2, 0, 2]
    found = scans.accuracy_of(TABLE.truth, answers["filter"], 3)
    assert found.confusion == [[1, 0, 1], [1, 1, 0], [0, 0, 2]]
    assert found.right == pytest.approx(4 / 6)
    assert found.recall == pytest.approx([1 / 2, 1 / 2, 1])
    assert found.even == pytest.approx((1 / 2 + 1 / 2 + 1) / 3)


KITTI = LABEL_SETS["kitti"]
ROAD, FENCE, NONE, OTHER = 9, 14, 0, 77


def _scan(away, label):
    points = np.zeros((len(away), 3), np.float32)
    points[:, 0] = away
    return Scan(points, label=np.array(label, np.uint16), name="one")


def test_ground_is_counted_between_4_and_80_m_where_points_have_a_label():
    scan = _scan([5, 6, 7, 8, 9, 10, 3, 81], [ROAD, ROAD, ROAD, FENCE, NONE, OTHER, ROAD, ROAD])
    found = np.array([True, True, False, True, True, True, True, True])
    score = scans.ground_score(scan, found, KITTI)
    assert (score["frame"], score["points"]) == ("one", 4)
    assert (score["precision"], score["recall"], score["f1"]) == pytest.approx((2 / 3, 2 / 3, 2 / 3))


def test_nothing_found_has_no_precision_and_a_frame_without_ground_no_part_in_the_mean():
    scan = _scan([5, 6], [ROAD, FENCE])
    score = scans.ground_score(scan, np.zeros(2, np.bool_), KITTI)
    assert np.isnan(score["precision"])
    assert (score["recall"], score["f1"]) == (0.0, 0.0)
    bare = scans.ground_score(_scan([5], [FENCE]), np.zeros(1, np.bool_), KITTI)
    good = {"frame": "two", "points": 10, "precision": 1.0, "recall": 0.5, "f1": 0.8}
    mean = {"frame": "mean", "points": 12, "precision": 1.0, "recall": 0.25, "f1": 0.4}
    assert scans.mean_ground([score, good, bare]) == mean
    assert np.isnan(scans.mean_ground([bare])["f1"])


def test_points_of_obstacles_are_looked_for_in_free_sectors():
    # Four sectors: smooth, smooth with an obstacle, rough, without ground; a fence point in each and in none.
    scan = _scan([5, 5, 5, 5, 5, 5, 3, 5], [FENCE] * 7 + [ROAD])
    rng = np.random.default_rng(1)
    around = np.column_stack([rng.uniform(-12, 12, (20_000, 2)), np.zeros(20_000)]).astype(np.float32)
    sectors = polar_sectors(Scan(around))
    stack = replace(
        sectors,
        obstacle=np.arange(len(sectors.zone)) == 1,
        point_ground=np.zeros(8, np.bool_),
        point_sector=np.array([0, 0, 1, 2, 3, -1, 0, 0], np.int32),
        point_height=np.array([0.5, 3.0, 0.5, 0.5, np.nan, np.nan, 0.5, 0.0], np.float32),
    )
    class_id = np.full(len(sectors.zone), 255, np.uint8)
    class_id[:3] = 0, 1, 2
    classed = replace(classify_filter(sectors), sectors=stack, class_id=class_id)
    score = scans.obstacle_score(scan, classed, KITTI)
    assert score == {"points": 6, "in_free": 2, "in_free_low": 1, "in_free_class": 3}


@pytest.mark.parametrize(
    ("name", "known", "least"), [("kitti_labelled", "kitti", 0.98), ("solid_state_labelled", "semantic-kitti", 0.965)]
)
def test_labels_are_told_ground_is_found_and_obstacles_lie_in_sectors_that_say_so(shared_data, name, known, least):
    frames = find_frames([shared_data / "scans" / name])
    labels, ground, total = scans.labels_of(frames, None), [], Counter()
    assert labels.name == known
    for scan in map(read_scan, frames):
        stack = polar_sectors(scan)
        ground.append(scans.ground_score(scan, stack.point_ground, labels))
        smooth = np.where(stack.traversable, 0, 255).astype(np.uint8)  # the flag alone, without the help of classes
        total.update(scans.obstacle_score(scan, replace(classify_filter(stack), class_id=smooth), labels))
    assert scans.mean_ground(ground)["f1"] > least
    assert min(score["f1"] for score in ground) > 0.9
    assert total["points"] > 4000
    assert total["in_free"] < 0.05 * total["points"] < total["in_free_class"]


@pytest.fixture
def drive(tmp_path):
    """Two frames of a field that is smooth on the right and churned on the left."""
    folder = tmp_path / "drive"
    for frame in range(2):
        write_bin(folder / f"{frame:06d}.bin", churned_field(frame))
    return folder


@pytest.fixture
def evaluate(drive, tmp_path):
    """The command on the drive: what it printed, its record and its page."""

    def evaluated(*words):
        out = tmp_path / "out"
        made = run("evaluate", "scans", drive, "--out", out, *words)
        assert made.exit_code == 0, made.output
        text = (out / "report.md").read_text()
        assert "nan" not in text
        return made.output, json.loads((out / "report.json").read_text()), text

    return evaluated


@pytest.mark.parametrize("method", ["filter", "learned"])
def test_one_method_is_judged_alone(drive, evaluate, method):
    label_drive(drive, (14, 9))
    printed, record, text = evaluate("--set", f"method={method}")
    other = ({"filter", "learned"} - {method}).pop()
    assert {*record["obstacles"]} == {method}
    assert f"`{method}`" in text
    assert other not in {*record["accuracy"], *printed.split()}
    assert (record["facts"]["network"] is None) == (method == "filter")


def test_a_network_is_none_of_the_filter(drive, tmp_path):
    made = run("evaluate", "scans", drive, "--set", "method=filter", "--set", "model=a.onnx", "--out", tmp_path / "out")
    assert (made.exit_code, "give one of them" in made.output) == (2, True)


def label_drive(folder, ids):
    """Label the left side of frames from ``ground`` with one id, the right with another."""
    for frame in folder.glob("*.bin"):
        left = np.fromfile(frame, "<f4").reshape(-1, 4)[:, 1] > 0
        np.where(left, *ids).astype("<u4").tofile(frame.with_suffix(".label"))


def test_labels_set_both_methods_beside_constant_answers_and_a_report_is_not_replaced(drive, evaluate, tmp_path):
    label_drive(drive, (14, 9))  # a fence all over the left side, road on the right
    printed, record, text = evaluate("--labels", "kitti")
    names = ["filter", "learned", "always 0", "always 1", "always 2", "deviation of z"]
    assert list(record["accuracy"]) == list(record["accuracy_all"]) == names
    assert record["facts"]["labels"] == "kitti"
    constant = record["accuracy"]["always 2"]
    assert (constant["recall"], constant["even"]) == ([0.0, None, 1.0], 0.5)
    assert [row["frame"] for row in record["ground"]] == ["000000", "000001", "mean"]
    assert all(0 < row["precision"] < 1 and row["recall"] > 0.95 for row in record["ground"])
    assert set(record["obstacles"]) == {"filter", "learned"}
    assert all(f"| {name} |" in text and name in printed for name in names)
    again = run("evaluate", "scans", drive, "--out", tmp_path / "out")
    assert (again.exit_code != 0, "--overwrite" in again.output) == (True, True)


@pytest.mark.parametrize(
    ("ids", "words", "code", "message"),
    [
        ((70, 40), ("--labels", "kitti"), 3, "not those of the set kitti"),
        ((500, 501), (), 3, "fit no label set"),
        ((14, 9), ("--labels", "nuscenes"), 2, "it must be kitti"),
        (None, ("--labels", "kitti"), 3, "has no labels"),
        (None, (), 3, "has no labels"),
        ((14, 9), ("--labels", "kitti"), 3, "no scan has a sector"),
    ],
)
def test_labels_of_another_set_and_drives_without_sectors_are_refused(drive, tmp_path, ids, words, code, message):
    if ids:
        label_drive(drive, ids)
    if "no scan" in message:
        for frame in drive.glob("*.bin"):
            points = np.fromfile(frame, "<f4").reshape(-1, 4)
            (points * np.float32(0.01)).tofile(frame)
    done = run("evaluate", "scans", drive, *words, "--out", tmp_path / "out")
    assert done.exit_code == code, done.output
    assert re.search(message, done.output.replace("\n", " "))
    assert not (tmp_path / "out" / "report.md").exists()
