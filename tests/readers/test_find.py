import pytest

from bumpymap.core.errors import BadInputError
from bumpymap.readers import find_surveys


@pytest.fixture
def folder(tmp_path):
    for name in (
        "b.LAZ",
        "a.las",
        "c.copc.laz",
        "sub/d.Ply",
        "sub/deep/e.pcd",
        "notes.txt",
        ".hidden.las",
        ".git/f.las",
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    return tmp_path


def names(folder, paths):
    return [str(path.relative_to(folder)) for path in paths]


def test_a_folder_is_searched_with_its_subfolders(folder):
    assert names(folder, find_surveys([folder])) == ["a.las", "b.LAZ", "c.copc.laz", "sub/d.Ply", "sub/deep/e.pcd"]


def test_order_and_repetition_of_what_was_typed_do_not_matter(folder):
    typed = [folder / "sub", folder / "a.las", folder / "sub" / "d.Ply", folder / "sub" / ".." / "a.las"]
    assert names(folder, find_surveys(typed[:3])) == ["a.las", "sub/d.Ply", "sub/deep/e.pcd"]
    assert len(find_surveys(typed)) == 3


def test_a_file_reached_by_a_link_counts_once(folder):
    (folder / "z.las").symlink_to(folder / "a.las")
    assert len(find_surveys([folder / "a.las", folder / "z.las"])) == 1


def test_a_named_file_is_taken_whatever_its_ending(folder):
    assert names(folder, find_surveys([folder / "notes.txt"])) == ["notes.txt"]


def test_nothing_to_read(folder, tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(BadInputError, match="empty holds no point cloud"):
        find_surveys([folder / "a.las", empty])
    with pytest.raises(BadInputError, match="does not exist"):
        find_surveys([folder / "nowhere"])
    with pytest.raises(BadInputError, match="no survey was given"):
        find_surveys([])
