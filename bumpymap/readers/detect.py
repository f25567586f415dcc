"""Which reader a file needs, by its content: an ending proves nothing."""

import logging
from codecs import getincrementaldecoder
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.protocol import ReadOptions, SurveyReader
from bumpymap.readers.source import Location, OpenFile, open_source
from bumpymap.readers.versioned import VersionedSurvey

if TYPE_CHECKING:
    from bumpymap.readers.point_table import PointTable, Wanted

__all__ = ["detect_format", "open_survey", "read_columns", "reopen_survey"]

_log = logging.getLogger(__name__)

Kind = Literal["las", "ply", "pcd"]
_READABLE = "bumpymap reads LAS, LAZ, COPC, PLY and PCD"
_HEAD = 1024

_FOREIGN = (
    (b"version https://git-lfs", "a Git LFS pointer, not the data itself. Fetch the data with: git lfs pull"),
    (b"ASTM-E57", "an E57 file. Convert it with: pdal translate --reader readers.e57 IN OUT.laz"),
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"II*\0", "a TIFF picture; a raster holds no points"),
    (b"MM\0*", "a TIFF picture; a raster holds no points"),
    (b"PK\x03\x04", "a ZIP archive. Unpack it first"),
    (b"\x1f\x8b", "a gzip archive. Unpack it first"),
    (b"7z\xbc\xaf", "a 7z archive. Unpack it first"),
    (b"%PDF", "a PDF document"),
    (b"\x89HDF", "an HDF5 file"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"<", "an XML or HTML page; did a download give an error page?"),
    (b"{", "a JSON text"),
)
"""How files begin that are taken for point clouds now and then."""


def open_survey(path: Location, options: ReadOptions = ReadOptions()) -> SurveyReader:  # noqa: B008 (frozen, no state)
    """Open a point cloud and check what its header says; points are read later. Its notes are logged as warnings.

    Parameters
    ----------
    path : Path or str
        A path, or the text of a URL.
    options : ReadOptions

    Returns
    -------
    SurveyReader

    Raises
    ------
    BadInputError
        The file cannot be read, is not a point cloud, holds no points, promises more than it can hold, or is not in
        a projected CRS.
    UsageError
        ``options.crs`` is no CRS.
    """
    reader = reopen_survey(path, options)
    for note in reader.info.notes:
        _log.warning("%s: %s", path, note)
    return reader


def reopen_survey(path: Location, options: ReadOptions = ReadOptions()) -> SurveyReader:  # noqa: B008 (as above)
    """Open a point cloud again, in a worker; its notes were logged already. As ``open_survey`` otherwise."""
    return VersionedSurvey(path, partial(_reader, path, options))


def _reader(path: Location, options: ReadOptions) -> SurveyReader:
    kind = detect_format(path)
    if kind == "las":
        from bumpymap.readers.las import LasSurvey

        return LasSurvey(path, options)
    from bumpymap.readers.point_table import CLASSES, TableSurvey

    file = OpenFile(path)
    if kind == "ply":
        from bumpymap.readers.ply import PlyTable

        return TableSurvey(PlyTable(file, CLASSES), options)
    from bumpymap.readers.pcd import PcdTable

    return TableSurvey(PcdTable(file, CLASSES, options.memory), options)


def read_columns(path: Path, wanted: "Wanted") -> dict[str, NDArray[Any]]:
    """Read the points of a PLY or PCD file whole, opening it once.

    Parameters
    ----------
    path : Path
    wanted : dict of str to tuple of str
        What is wanted beside x, y and z, where it is there, and the columns that may hold it, in lower case.

    Returns
    -------
    dict of str to array (n,)
        By the names that ``wanted`` gives; x, y and z too.

    Raises
    ------
    BadInputError
        The file cannot be read, is neither PLY nor PCD, promises more than it holds, or is damaged.
    """
    with open_source(path) as stream:
        kind, file = _format_of(path, stream.read(_HEAD)), OpenFile(path, stream)
        if kind == "las":
            raise BadInputError(
                f"{path} is a survey (LAS) and not a scan of a robot; scans are PLY, PCD or KITTI-style .bin files. "
                "Map a survey with: bumpymap map"
            )
        if kind == "ply":
            from bumpymap.readers.ply import PlyTable

            table: PointTable = PlyTable(file, wanted)
        else:
            from bumpymap.readers.pcd import PcdTable

            table = PcdTable(file, wanted, ReadOptions().memory, np.float64)
        rows = table.whole()
    return {what: rows[name] for what, name in table.info.find(wanted).items()}


def detect_format(path: Location) -> Kind:
    """Tell the format by the first bytes.

    Raises
    ------
    BadInputError
        The file cannot be read, is empty, or is something else; says what it looks like.
    """
    with open_source(path) as stream:
        return _format_of(path, stream.read(_HEAD))


def _format_of(path: Location, head: bytes) -> Kind:
    if not head:
        raise BadInputError(f"{path} is empty (0 bytes). Copy or download it again")
    if head.startswith(b"LASF"):
        return "las"
    if head.split(None, 1)[:1] == [b"ply"]:
        return "ply"
    if _is_pcd(head):
        return "pcd"
    raise BadInputError(f"{path} is not a point cloud: it is {_describe(head)}. {_READABLE}")


def _is_pcd(head: bytes) -> bool:
    words = [line.split()[:1] for line in head.splitlines() if not line.startswith(b"#")]
    return head.startswith(b"# .PCD") or [b"VERSION"] in words[:2] or [b"FIELDS"] in words[:2]


def _describe(head: bytes) -> str:
    for start, what in _FOREIGN:
        if head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(start):
            return what
    if not head.strip(b"\0"):
        return "nothing but zero bytes: an interrupted copy?"
    if _is_text(head):
        return "a text file. A list of points under a first line 'X Y Z' is converted by: pdal translate IN.txt OUT.laz"
    return f"of an unknown kind (first bytes {head[:8].hex(' ')})"


def _is_text(head: bytes) -> bool:
    try:
        # Incremental: the last character may be cut.
        text = getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return False
    return all(letter.isprintable() or letter in "\r\n\t" for letter in text)
