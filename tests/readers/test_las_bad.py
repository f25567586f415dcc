"""Files that lie or are damaged: one message each, never another exception, never a lost process."""

import struct

import lazrs
import numpy as np
import pytest

from bumpymap.core.errors import BadInputError
from bumpymap.readers import ReadOptions, decoder, open_survey

DEFAULT = ReadOptions()
MAX_X, MIN_X, MAX_Y, MIN_Y = 179, 187, 195, 203


def exhaust(path, options=DEFAULT):
    reader = open_survey(path, options)
    return sum(cloud.easting.size for cloud in reader.clouds())


def refused(path, *says, options=DEFAULT):
    with pytest.raises(BadInputError) as caught:
        exhaust(path, options)
    message = str(caught.value)
    assert str(path) in message
    for words in says:
        assert words in message, message
    return message


@pytest.mark.parametrize(
    ("place", "layout", "value", "says"),
    [
        (107, "<I", 8, "declares 8 points"),
        (107, "<I", 0, "holds no points"),
        (100, "<I", 0xFFFFFFFF, "variable length records"),
        (96, "<I", 0xFFFFFFFF, "bytes long"),
        (104, "<B", 11, "format 11"),
        (104, "<B", 0x81, "LASzip record"),
        (105, "<H", 19, "19 bytes"),
        (24, "<B", 2, "LAS 2.2"),
        (25, "<B", 9, "LAS 1.9"),
        (131, "<d", np.nan, "scale"),
        (139, "<d", 0.0, "scale"),
        (171, "<d", -np.inf, "offset"),
        (131, "<d", 1e300, "coordinates finite"),
        (131, "<d", 1e8, "not a location on Earth"),
    ],
)
def test_a_header_that_cannot_be(las, place, layout, value, says):
    # A raw coordinate of 1e9 makes a scale of 1e300 overflow.
    points = np.vstack([las.points, [500000.0 + 1_000_000, 4000000.0, 0.0]])[1:]
    refused(las.patch(las.write(points=points), place, layout, value), says)


def test_a_chunk_that_is_too_large_to_be_decoded_at_once(las, laz, monkeypatch):
    path = laz.pack(las.write(), 5)
    monkeypatch.setattr("bumpymap.readers.copc._LARGEST_CHUNK", 5 * 28 - 1)
    refused(path, "holds 5 points", "pdal translate")


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({MIN_X: np.nan}, "impossible extent"),
        ({MAX_Y: np.inf}, "impossible extent"),
        ({MIN_X: 600000.0}, "impossible extent"),
        ({MIN_X: -2e9, MAX_X: 2e9}, "-2,000,000,000.00 to 2,000,000,000.00"),
        ({MIN_X: 0.0, MAX_X: 0.0, MIN_Y: 0.0, MAX_Y: 0.0}, "7 of 7 points are outside"),
        ({MAX_X: 500003.9}, "1 of 7 points are outside"),
        ({MAX_Y: 4000000.0 + 20_000}, "20,000"),
    ],
)
def test_a_header_that_lies_about_its_extent(las, name, changes, says):
    path = las.write(name)
    for place, value in changes.items():
        las.patch(path, place, "<d", value)
    message = refused(path, says, "`trust_points=True`")
    if says != "impossible extent":
        assert "500,000.00 to 500,005.00" in message
    assert open_survey(path, ReadOptions(trust_points=True)).info.bounds is None
    assert exhaust(path, ReadOptions(trust_points=True)) == 7


@pytest.mark.parametrize(
    "changes",
    [
        {MAX_X: 500004.2},  # rounded by less than a metre
        {MIN_X: 499999.5},
        {MAX_X: 500004.999 + 9_000},  # far, but no 10 km
    ],
)
def test_a_header_that_is_a_little_off_is_no_lie(las, changes):
    path = las.write()
    for place, value in changes.items():
        las.patch(path, place, "<d", value)
    assert exhaust(path) == 7


def test_a_large_box_around_large_data_is_no_lie(las):
    points = np.array([[0.0, 0.0, 0.0], [30_000.0, 40_000.0, 5.0]])
    path = las.write(points=points, offset=(0, 0, 0))
    las.patch(path, MAX_X, "<d", 100_000.0)
    assert exhaust(path) == 2


def test_a_panic_of_the_decoder_becomes_a_message(las, monkeypatch):
    class PanicException(BaseException):
        """As pyo3 raises: no ``Exception``."""

    def panic(*_):
        raise PanicException("index out of bounds: the len is 3\nnote: a backtrace")

    path = las.write("a.laz")
    monkeypatch.setattr(decoder, "current", decoder.Decoder(0))
    monkeypatch.setattr(lazrs, "decompress_points_with_chunk_table", panic)
    message = refused(path, "index out of bounds: the len is 3")
    assert "backtrace" not in message


def test_an_interrupt_passes(las, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(decoder, "current", decoder.Decoder(0))
    monkeypatch.setattr(lazrs, "decompress_points_with_chunk_table", interrupt)
    with pytest.raises(KeyboardInterrupt):
        exhaust(las.write("a.laz"))


@pytest.mark.parametrize("held", [3, 0])
def test_a_chunk_of_fewer_points_than_its_table_promises(las, held):
    """The decoder does not look at the count that a chunk of layers carries, and makes points up."""
    path = las.write("a.laz", version="1.4", fmt=6)
    (points_at,) = struct.unpack_from("<I", path.read_bytes(), 96)
    refused(las.patch(path, points_at + 8 + 30, "<I", held), f"declares 7 points in a LAZ chunk but holds {held}")
