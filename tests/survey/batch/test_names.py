"""Names of the folders of a batch: of any set of files, all different, and none that is not a folder's."""

from pathlib import Path

from hypothesis import given, strategies as st

from bumpymap.layers import BATCH_NAMES
from bumpymap.survey.batch.source import name_surveys, plain_name

ROOT = Path("/surveys")
WORDS = st.sampled_from(["a", "A", "site", "a_site", ".b", "summary.csv", "log.jsonl", "a_2", "site_laz"])
PATHS = st.lists(
    st.tuples(st.lists(WORDS, max_size=2), WORDS, st.sampled_from([".laz", ".las", ".copc.laz"])), max_size=12
)


def names(*paths, given=None):
    return name_surveys([ROOT / path for path in paths], given or [None] * len(paths), ROOT)


@given(PATHS)
def test_names_differ_and_can_be_those_of_folders(parts):
    places = list(dict.fromkeys(ROOT.joinpath(*folders, f"{word}{suffix}") for folders, word, suffix in parts))
    found = name_surveys(places, [None] * len(places), ROOT)
    assert len({name.casefold() for name in found}) == len(places)
    assert not [name for name in found if plain_name(name)]


def test_a_survey_is_named_after_its_file():
    assert names("north.laz", "deep/south.copc.laz", "x.y.las") == ["north", "south", "x.y"]


def test_those_of_one_name_get_those_of_their_folders_and_then_the_suffix():
    assert names("m/site.laz", "t/site.laz", "other.laz") == ["m_site", "t_site", "other"]
    assert names("site.laz", "site.las") == ["site_laz", "site_las"]
    assert names("Site.laz", "d/site.laz") == ["Site", "d_site"]


def test_given_names_are_kept():
    assert names("a.laz", "b/a.laz", given=["a", None]) == ["a", "b_a"]
    assert names("a.laz", "b.laz", given=["b", None])[0] == "b"


def test_names_of_files_of_the_batch_are_not_taken():
    assert not set(names(*(f"{name}.laz" for name in BATCH_NAMES))) & set(BATCH_NAMES)


def test_the_name_of_a_url_is_that_of_its_file():
    assert name_surveys(["https://example.org/a/site.copc.laz"], [None], ROOT) == ["site"]


def test_a_key_in_a_url_is_in_no_name():
    urls = [
        "https://example.org/a/site.laz?sig=ab.cd",
        "https://me:word@example.org/b/site.laz",
        "s3://box/site.laz?/k",
    ]
    assert name_surveys(urls, [None] * 3, ROOT) == ["a_site", "b_site", "box_site"]
