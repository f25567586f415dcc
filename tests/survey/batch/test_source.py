"""The surveys that a batch finds in folders, lists and tables; whose settings count; and the names of their maps."""

from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from small_surveys import write_survey

from bumpymap.core import BadInputError, UsageError
from bumpymap.survey import BatchConfig, run_batch
from bumpymap.survey.batch.run import list_surveys, name_surveys, plain_name


def found(source, survey_per="file"):
    return {name: place for place, name, _ in list_surveys(source, survey_per)}


@pytest.fixture
def flights(tmp_path):
    folder = tmp_path / "flights"
    for name in ("one/1.laz", "one/deep/2.laz", "two/1.laz", "notes/a.pdf"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def test_each_file_of_a_folder_and_those_of_a_list(flights, tmp_path):
    (tmp_path / "some.txt").write_text("# tonight\nflights/one\n\n")
    assert found(tmp_path / "some.txt") == {"one": flights / "one"}
    assert found(flights) == {
        "one_1": flights / "one/1.laz",
        "2": flights / "one/deep/2.laz",
        "two_1": flights / "two/1.laz",
    }


def test_each_folder_of_a_folder(flights, caplog):
    assert found(flights, "folder") == {"one": flights / "one", "two": flights / "two"}
    assert "notes holds no point cloud" in caplog.text
    (flights / "loose.laz").touch()
    with pytest.raises(UsageError, match=r"itself holds loose\.laz"):
        found(flights, "folder")


@pytest.mark.parametrize(
    ("name", "text", "error", "said"),
    [
        ("none.csv", None, BadInputError, "does not exist"),
        ("a.laz", "", UsageError, "bumpymap map"),
        ("a.txt", "# nothing\n", BadInputError, "names no survey"),
        ("a.txt", "a.laz\n./a.laz\n", UsageError, "listed twice"),
        ("a.csv", "", UsageError, "no column survey"),
        ("a.csv", "survey,crs,crs\n", UsageError, "crs is there twice"),
        ("a.csv", "survey,name\na.laz,.b\n", UsageError, "the name is '.b'"),
        ("a.csv", "survey,crss\na.laz,1\n", UsageError, "unknown column crss"),
        ("a.csv", "survey,local,crs\na.laz,TRUE,EPSG:1\n", UsageError, "contradict each other"),
        ("a.csv", "survey,crs\n,EPSG:1\n", UsageError, "line 2: the survey is empty"),
        ("a.csv", "survey\na.laz,b\n", UsageError, "it has 2 cells"),
        ("a.csv", "survey,name\na.laz,x\nb.laz,X\n", UsageError, "the name x is given twice"),
    ],
)
def test_faults_of_a_list_are_said(tmp_path, name, text, error, said):
    for place in ("a.laz", "b.laz"):
        (tmp_path / place).touch()
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(error) as caught:
        list_surveys(tmp_path / name, "file")
    assert said in str(caught.value)


def test_all_faults_of_all_rows_are_said_at_once(tmp_path):
    """A value of the wrong kind, or a column too many, hides neither a value out of bounds nor a missing file."""
    head = "survey,name,crs,vehicle,model,tile_size,pixels,max_unknown,ground,colour\n"
    row = "none.laz,../b,EPSG:99999,truck,none.onnx,-3,2.5,150%,CSV,red\n"
    (tmp_path / "b.laz").touch()
    (tmp_path / "a.csv").write_text(f"{head}{row}b.laz,,,,,,many,,,\n")
    with pytest.raises(UsageError) as caught:
        run_batch(BatchConfig(tmp_path / "a.csv", tmp_path / "o"))
    for said in (
        "11 errors",
        "unknown column colour; there are: survey, name, tile_size",
        "there is no file or folder",
        "'EPSG:99999' is not a coordinate reference system",
        "no vehicle 'truck'",
        "tile_size is -3; it must be a number from 0.05 to 1000 m",
        "line 3: pixels is 'many'",
        "max_unknown is '150%'; it must be a number from 0 to 1",
        "ground is 'CSV'; it must be one of auto, all, class, csf",
    ):
        assert said in str(caught.value)
    assert not (tmp_path / "o").exists()


def test_a_fault_of_all_surveys_is_said_before_the_first(tmp_path):
    write_survey(tmp_path / "a.las")
    with pytest.raises(UsageError, match="settings for all surveys"):
        run_batch(BatchConfig(tmp_path, tmp_path / "o", {"vehicle": "truck"}))
    with pytest.raises(UsageError, match="Give `jobs=1`, or no `scheduler`"):
        run_batch(BatchConfig(tmp_path, tmp_path / "o", {"scheduler": "tcp://a:1"}, jobs=2))
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("separator", [",", ";"])
def test_the_columns_of_a_table_are_settings(tmp_path, separator):
    text = "survey,name,--tile-size,Pixels,local,vehicle,calibration,max_unknown,ground_classes\n"
    text += f"a b.laz,n,2.5,11,true,,own.json,50%,\n{tmp_path}/x/c.laz,,,,false,own.toml,,0.25,2 8 17\n"
    for name in ("a b.laz", "x/c.laz"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "a.csv").write_bytes(b"\xef\xbb\xbf" + text.replace(",", separator).encode())
    second, first = list_surveys(tmp_path / "a.csv", "file")
    own = {"tile_size": 2.5, "pixels": 11, "local": True, "calibration": tmp_path / "own.json", "max_unknown": 0.5}
    assert first == (tmp_path / "a b.laz", "n", own)
    own = {"local": False, "vehicle": str(tmp_path / "own.toml"), "max_unknown": 0.25, "ground_classes": (2, 8, 17)}
    assert second == (tmp_path / "x" / "c.laz", "c", own)


def test_the_command_line_is_over_the_table_and_the_table_over_the_file(tmp_path):
    defaults = {"ground": "class", "align": "off", "vehicle": "car", "rating": "table"}
    config = BatchConfig(tmp_path, tmp_path, given={"ground": "all", "crs": "EPSG:1"}, defaults=defaults)
    made = config.of_survey({"ground": "csf", "align": "report", "calibration": "c.json", "local": True})
    assert (made.ground, made.align, made.rating) == ("all", "report", "table")
    assert (made.crs, made.local) == ("EPSG:1", False)  # what is typed overrides what contradicts it
    assert (made.calibration, made.vehicle) == ("c.json", "warthog")  # and so does the table


def test_memory_and_threads_are_shared_out(tmp_path):
    config = BatchConfig(tmp_path, tmp_path, given={"memory": "1GB", "threads": 5}, jobs=2)
    own = config.share(config.of_survey({}), 2)
    assert (own.memory, own.threads) == ("512MB", 2)
    assert config.share(config.of_survey({}), 8).threads == 1
    with pytest.raises(UsageError, match="Give 1152MB or more"):
        BatchConfig(tmp_path, tmp_path, given={"memory": "1GB"}, jobs=9)
    given = {"memory": "2GB", "threads": 5}
    assert [BatchConfig(tmp_path, tmp_path, given).jobs_for(n * [9]) for n in (1, 3, 8)] == [1, 3, 4]
    assert [BatchConfig(tmp_path, tmp_path, given).jobs_for([9, size]) for size in (0, 10**9)] == [1, 1]


ROOT = Path("/surveys")
WORDS = st.sampled_from(["a", "A", "site", "a_site", ".b", "summary.csv", "collection.json", "a_2", "site_laz"])
PATHS = st.lists(
    st.tuples(st.lists(WORDS, max_size=2), WORDS, st.sampled_from([".laz", ".las", ".copc.laz"])), max_size=12
)


@given(PATHS)
def test_names_differ_and_can_be_those_of_folders(parts):
    places = list(dict.fromkeys(ROOT.joinpath(*folders, f"{word}{suffix}") for folders, word, suffix in parts))
    found = name_surveys(places, [""] * len(places), ROOT)
    assert len({name.casefold() for name in found}) == len(places)
    assert not [name for name in found if plain_name(name)]


@pytest.mark.parametrize(
    ("paths", "given", "expected"),
    [
        (["north.laz", "deep/south.copc.laz", "x.y.las"], None, ["north", "south", "x.y"]),
        (["m/site.laz", "t/site.laz", "other.laz"], None, ["m_site", "t_site", "other"]),
        (["site.las", "site.laz"], None, ["site", "site_2"]),
        (["a.laz", "b/a.laz"], ["a", ""], ["a", "b_a"]),
    ],
)
def test_a_survey_has_the_name_of_its_file_as_much_of_its_folders_as_it_takes_or_that_which_is_given(
    paths, given, expected
):
    assert name_surveys([ROOT / path for path in paths], given or [""] * len(paths), ROOT) == expected
