"""The folder of a scan run: what may be there before, what goes, what stays."""

import pytest

from bumpymap.core.errors import OutputError
from bumpymap.layers import check_scan_folder, remove_stale_products


def fill(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


@pytest.mark.parametrize("name", ["sectors.parquet", "frames/a.png", "map/run.json"])
def test_products_of_an_earlier_run_need_a_word(tmp_path, name):
    fill(tmp_path, name)
    with pytest.raises(OutputError, match=r"already holds .*`overwrite=True`"):
        check_scan_folder(tmp_path, overwrite=False)
    fill(tmp_path, "scan.json")
    check_scan_folder(tmp_path, overwrite=True)
    assert names(tmp_path) == sorted({name, "scan.json"})


def test_files_that_would_go_with_the_frames_and_that_no_run_wrote_are_refused(tmp_path):
    fill(tmp_path, "frames/a.png")
    with pytest.raises(OutputError, match="frames was not written by a complete scan run"):
        check_scan_folder(tmp_path, overwrite=True)
    fill(tmp_path, "scan.json", "frames/notes.txt")
    with pytest.raises(OutputError, match=r"notes\.txt was not written by a complete scan run"):
        check_scan_folder(tmp_path, overwrite=True)


@pytest.mark.parametrize("ended", [True, False])
def test_the_scans_that_are_read_are_not_replaced(tmp_path, ended):
    fill(tmp_path, "drive/frames/0.ply", *(["drive/scan.json"] if ended else []))
    (tmp_path / "link").symlink_to(tmp_path / "drive")
    with pytest.raises(OutputError, match="is an input of this run"):
        check_scan_folder(tmp_path / "drive", [tmp_path / "link" / "frames" / "0.ply"], overwrite=True)
    check_scan_folder(tmp_path / "out", [tmp_path / "link" / "frames" / "0.ply"], overwrite=True)


@pytest.mark.parametrize("name", ["frames", "scan.json/a"])
def test_a_file_for_a_folder_and_a_folder_for_a_file_are_refused(tmp_path, name):
    fill(tmp_path, name)
    with pytest.raises(OutputError, match="not what a scan run writes"):
        check_scan_folder(tmp_path, overwrite=True)


def test_older_products_go_and_everything_else_stays(tmp_path):
    fill(tmp_path, "frames/a.png", "gathered.laz", "sectors.parquet", "scan.json", "notes.txt")
    fill(tmp_path, "map/run.json", "map/rasters/class.tif", "map/rasters/class.tif.aux.xml", "map/my_style.qml")
    remove_stale_products(tmp_path, ("scan.json", "sectors.parquet"))
    assert names(tmp_path) == ["map/my_style.qml", "notes.txt", "scan.json", "sectors.parquet"]
    assert not (tmp_path / "frames").exists()
    (tmp_path / "map" / "my_style.qml").unlink()
    fill(tmp_path, "map/run.json")
    remove_stale_products(tmp_path, ("scan.json", "sectors.parquet"))
    assert not (tmp_path / "map").exists()
