"""Names of the folders of a batch: of any set of files, all different, and none that is not a folder's."""

from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from bumpymap.survey.batch.source import name_surveys, plain_name

ROOT = Path("/surveys")
WORDS = st.sampled_from(["a", "A", "site", "a_site", ".b", "summary.csv", "log.jsonl", "a_2", "site_laz"])
PATHS = st.lists(
    st.tuples(st.lists(WORDS, max_size=2), WORDS, st.sampled_from([".laz", ".las", ".copc.laz"])), max_size=12
)


@given(PATHS)
def test_names_differ_and_can_be_those_of_folders(parts):
    places = list(dict.fromkeys(ROOT.joinpath(*folders, f"{word}{suffix}") for folders, word, suffix in parts))
    found = name_surveys(places, [None] * len(places), ROOT)
    assert len({name.casefold() for name in found}) == len(places)
    assert not [name for name in found if plain_name(name)]


@pytest.mark.parametrize(
    ("paths", "given", "expected"),
    [
        (["north.laz", "deep/south.copc.laz", "x.y.las"], None, ["north", "south", "x.y"]),
        (["m/site.laz", "t/site.laz", "other.laz"], None, ["m_site", "t_site", "other"]),
        (["site/ept.json", "m/site/ept.json", "pit/ept.json"], None, ["site", "m_site", "pit"]),
        (["site.las", "site.laz"], None, ["site", "site_2"]),
        (["Site.laz", "d/site.laz"], None, ["Site", "d_site"]),
        (["a.laz", "b/a.laz"], ["a", None], ["a", "b_a"]),
    ],
)
def test_a_survey_has_the_name_of_its_file_as_much_of_its_folders_as_it_takes_or_that_which_is_given(
    paths, given, expected
):
    assert name_surveys([ROOT / path for path in paths], given or [None] * len(paths), ROOT) == expected


def test_a_url_is_named_after_its_file_and_a_key_in_it_is_in_no_name():
    urls = [
        "https://example.org/a/site.copc.laz?sig=ab.cd",
        "https://me:word@example.org/b/site.laz",
        "s3://box/site.laz?/k",
        "https://example.org/a/own.copc.laz",
    ]
    assert name_surveys(urls, [None] * 4, ROOT) == ["a_site", "b_site", "box_site", "own"]
