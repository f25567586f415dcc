"""Keys in the URL of a survey, as that of a signed link, stand in no file that is handed on."""

from pathlib import Path

import pytest
from range_server import serving

import bumpymap
from bumpymap.core import recorded_place
from bumpymap.core.errors import OutputError

pytestmark = pytest.mark.slow

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"


@pytest.fixture
def address():
    pytest.importorskip("aiohttp")
    with serving(SAMPLE) as (found, handler):
        handler.headers_beside = {"ETag": '"version 1"'}  # by which a later run knows that it is the same file
        yield found


def test_no_file_of_a_map_holds_the_key_of_its_survey(address, tmp_path):
    url = f"{address}/quarry.laz?X-Signature=SECRETKEY"
    layers = bumpymap.map_survey(url, out=tmp_path / "out")
    held = [path.name for path in (tmp_path / "out").rglob("*") if path.is_file() and b"SECRETKEY" in path.read_bytes()]
    assert held == []
    (known,) = layers.manifest["inputs"]
    assert known["path"] == recorded_place(url)
    assert known["path"].startswith(f"{address}/quarry.laz?left-out=")
    again = bumpymap.map_survey(url, out=tmp_path / "out")
    assert again.manifest == layers.manifest
    with pytest.raises(OutputError, match="other inputs"):
        bumpymap.map_survey(url.replace("SECRETKEY", "ANOTHER"), out=tmp_path / "out")


def test_urls_with_other_keys_are_told_apart_and_others_stay_as_they_are():
    plain = ["https://example.org/a.laz", "s3://bucket/a.laz", "/data/a.laz?b", Path("a?b.laz"), "memory://a.laz"]
    assert [recorded_place(place) for place in plain] == [str(place) for place in plain]
    signed = ["https://example.org/get?file=a", "https://example.org/get?file=b", "https://me:word@example.org/get"]
    named = [recorded_place(place) for place in signed]
    assert len(set(named)) == 3
    assert all(name.startswith("https://example.org/get?left-out=") for name in named)
