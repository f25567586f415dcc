"""The checksum of a file is the same whatever the order in which its bytes are read."""

import hashlib

import numpy as np
import pytest
from blake3 import blake3

from bumpymap.core import BadInputError, FileHash, run_spec, same_content
from bumpymap.readers import hash_survey

PIECE = 1 << 20
SIZES = [0, 1, 1000, PIECE - 1, PIECE, PIECE + 1, 5 * PIECE + 12_345]


def content(size):
    return np.random.default_rng(size).bytes(size)


def expected(data):
    digests = [blake3(data[start : start + PIECE]).digest() for start in range(0, len(data), PIECE)]
    return f"blake3-1MiB:{blake3(b''.join(digests)).hexdigest()}"


def add(made, data, start, stop):
    made.add(start, data[start:stop])


class Rest:
    """Gives the bytes that are missing at the end, and counts them."""

    def __init__(self, data):
        self.data, self.read = data, 0

    def __call__(self, start, size):
        self.read += size
        return self.data[start : start + size]


@pytest.mark.parametrize("size", SIZES)
def test_of_a_file_that_nobody_has_read(size, tmp_path):
    data = content(size)
    (tmp_path / "a").write_bytes(data)
    assert hash_survey(tmp_path / "a") == expected(data)


@pytest.mark.parametrize("seed", range(8))
def test_in_any_order_with_gaps_and_overlaps(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    monkeypatch.setattr(run_spec, "MOST_PARTS", int(rng.choice([0, 1, 16])))
    data = content(SIZES[-1])
    made, seen = FileHash(len(data)), np.zeros(len(data), bool)
    for start in rng.integers(0, len(data), int(rng.integers(0, 40))):
        stop = start + int(rng.choice([10, 100_000, 1_500_000]))
        add(made, data, start, stop)
        seen[start:stop] = True
    rest = Rest(data)
    assert made.finish(rest) == expected(data)
    assert rest.read >= np.count_nonzero(~seen)


@pytest.mark.parametrize("seed", range(2))
def test_parts_in_any_order_are_read_once(seed):
    data = content(3 * PIECE + 7)
    cuts = np.sort(np.random.default_rng(seed).choice(len(data), 50, replace=False))
    spans = list(zip([0, *cuts], [*cuts, len(data)], strict=True))
    np.random.default_rng(seed).shuffle(spans)
    made, rest = FileHash(len(data)), Rest(data)
    for start, stop in spans[1:]:
        add(made, data, start, stop)
    assert made.finish(rest) == expected(data)
    assert rest.read in (PIECE, 7 + PIECE, 7)


def test_two_readers_share_a_file():
    data = content(SIZES[-1])
    one, two, both = (FileHash(len(data)) for _ in range(3))
    middle = 2 * PIECE + 500_000
    add(one, data, 0, middle)
    add(two, data, middle, len(data))
    for made in (one, two):
        both.put(made.take())
        assert made.take() == ()
    assert both.take() == (), "what was put is not new"
    rest = Rest(data)
    assert both.finish(rest) == expected(data)
    assert rest.read == PIECE


def test_a_file_that_ends_early():
    data = content(2 * PIECE)
    with pytest.raises(BadInputError, match="ends before byte 2,100,000"):
        FileHash(2_100_000).finish(Rest(data))


def test_content_is_compared_by_the_method_of_the_record(tmp_path):
    path = tmp_path / "site.las"
    path.write_bytes(content(PIECE + 5))
    here = {"size": PIECE + 5, "mtime_ns": "2"}
    data = path.read_bytes()
    for known in ({"checksum": expected(data)}, {"sha256": hashlib.sha256(data).hexdigest()}):
        assert same_content(str(path), {"bytes": PIECE + 5, "mtime_ns": "1", **known}, here, hash_survey)
        (name,) = known
        assert not same_content(str(path), {"mtime_ns": "1", name: known[name][:-1] + "x"}, here, hash_survey)
    assert not same_content(str(path), {"mtime_ns": "1", "checksum": "other:12"}, here, hash_survey)
    assert not same_content(str(path), {"mtime_ns": "1", "checksum": None}, here, hash_survey)
    assert not same_content(str(path), {"mtime_ns": "1"}, here, hash_survey)
