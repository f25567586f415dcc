"""Label sets: built in, from files, told from the ids, and refused where they are not those of the labels."""

import numpy as np
import pytest

from bumpymap.core import BadInputError, UsageError
from bumpymap.lab.label_sets import LABEL_SETS, label_set, require_label_set, tell_label_set

KITTI = np.array([0, 1, 9, 14, 15, 17, 18])
SEMANTIC = np.array([0, 40, 52, 70, 71, 72, 80])
RELLIS = np.array([0, 3, 4, 19, 33])
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
    assert set(ids[known.is_known(ids)]) == set(known.class_of) == set(known.names)


def test_a_set_from_a_file(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(CSV)
    known = label_set(path)
    assert known == label_set(str(path))
    assert known.class_of == {1: 0, 2: 2, 7: -1}
    assert (known.ground, known.obstacle) == ({1}, {2})
    assert known.names == {1: "lawn", 2: "wall", 7: "id 7"}


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


def test_no_set_and_no_file_are_refused():
    with pytest.raises(UsageError, match="kitti, semantic-kitti, rellis, or a file"):
        label_set("semantickitti")
    with pytest.raises(BadInputError, match="cannot read"):
        label_set("none/a.csv")


@pytest.mark.parametrize(("labels", "name"), [(KITTI, "kitti"), (SEMANTIC, "semantic-kitti"), (RELLIS, "rellis")])
def test_the_set_is_told_from_the_ids_and_others_are_refused(labels, name):
    assert tell_label_set(labels, "a.label").name == name
    require_label_set(labels, LABEL_SETS[name], "a.label")
    for other in set(LABEL_SETS) - {name}:
        with pytest.raises(BadInputError, match=f"not those of the set {other}"):
            require_label_set(labels, LABEL_SETS[other], "a.label")


def test_ids_that_exist_in_two_sets_are_told_by_their_ground_and_doubt_is_said():
    assert tell_label_set(np.array([3, 4, 19]), "a").name == "rellis"  # kitti: motorcycles, trucks, signs
    assert tell_label_set(np.array([9, 15, 17]), "a").name == "kitti"  # rellis: objects, logs, persons
    for labels, words in (([10, 18], "fit kitti and rellis; say which"), ([0, 500], "fit no"), ([0, 0], "ids none")):
        with pytest.raises(BadInputError, match=words):
            tell_label_set(np.array(labels), "a.label")
