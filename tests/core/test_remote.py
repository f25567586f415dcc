"""Keys in URLs stay out of what is written for others to read."""

import pytest

from bumpymap.core import without_keys


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("https://h/a/site.laz?X-Sig=k%2F.y", "https://h/a/site.laz"),
        (
            "cannot read https://me:word@h/a.laz?sig=k/2: 404, url='http://h/a.laz?k=1'",
            "cannot read https://h/a.laz: 404, url='http://h/a.laz'",
        ),
        ("the server of http://h:80/a.ply?sig=k does not", "the server of http://h:80/a.ply does not"),
        ("s3://bucket/night/site @ 3 m (see https://h/x?k=k).", "s3://bucket/night/site @ 3 m (see https://h/x)."),
        ("/data/what?/a@b.laz", "/data/what?/a@b.laz"),
    ],
)
def test_urls_have_no_user_and_no_query(text, shown):
    assert without_keys(text) == shown
