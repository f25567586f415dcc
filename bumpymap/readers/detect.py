"""Find the survey files that the user named, detect their format by content, not by suffix, and open them."""

import logging
import os
from codecs import getincrementaldecoder
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, FileHash, PieceRuns
from bumpymap.readers.point_stats import PointStats
from bumpymap.readers.protocol import CHUNK_POINTS, Chunk, ChunkPoints, ReadOptions, SurveyBase, SurveyReader
from bumpymap.readers.source import (
    Location,
    OpenFile,
    is_folder,
    is_url,
    list_folder,
    open_source,
    pinned_version,
    read_range,
    require_unchanged,
    version_of,
)

if TYPE_CHECKING:
    from bumpymap.readers.point_table import PointTable, Wanted

__all__ = ["SUFFIXES", "find_surveys", "open_survey", "read_columns", "reopen_survey"]

_MOST_HELD = 1 << 25
"""Bytes of a chunk that are kept until they are hashed."""


class VersionedSurvey(SurveyBase):
    """A ``SurveyReader`` that wraps another one, checks the version of its file, and makes its checksum.

    Parameters
    ----------
    path : Path or str
    open_reader : callable
        Opens the wrapped reader, which reads the header.
    checksum : bool
        Whether the checksum of the file is made from what is read; there is none for a URL.

    Raises
    ------
    BadInputError
        Raised here and by ``fetch``, ``convert`` and ``verify`` if the file was changed or removed.
    """

    def __init__(self, path: Location, open_reader: Callable[[], SurveyBase], *, checksum: bool = False) -> None:
        self._path, self._version = path, version_of(path)
        self._hash = FileHash(self._version["size"]) if checksum and not is_url(path) else None
        with pinned_version(path, self._version, None if self._hash is None else self._hash.add):
            self._reader = open_reader()
        if self._hash is not None:
            self._hash.drop_copies()  # thousands of files may be open
        super().__init__(replace(self._reader.info, version=self._version))

    @property
    def checksum(self) -> str | None:
        """See ``SurveyReader.checksum``."""
        return None if self._hash is None else self._hash.checksum

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Split the file into chunks; see ``SurveyReader.chunks``."""
        return self._reader.chunks(points)

    def fetch(self, chunk: Chunk) -> Any:
        """Read and decode a chunk; see ``SurveyReader.fetch``. What was read for it is hashed by ``convert``."""
        unhashed = None if self._hash is None else _Unhashed(self._hash)
        with self._may_be_bad(), pinned_version(self._path, self._version, None if unhashed is None else unhashed.add):
            fetched = self._reader.fetch(chunk)
        self._require_unchanged()
        return fetched if unhashed is None else (fetched, unhashed)

    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Convert a chunk to points in metres; see ``SurveyReader.convert``."""
        add = None
        if self._hash is not None:
            fetched, unhashed = fetched
            unhashed.finish()
            add = self._hash.add
        with self._may_be_bad(), pinned_version(self._path, self._version, add):
            converted = self._reader.convert(chunk, fetched)
        self._require_unchanged()
        return converted

    def verify(self, stats: PointStats) -> None:
        """Check all points against the header, and that the file is unchanged; see ``SurveyReader.verify``.

        Bytes that no reader has read are read here, for the checksum.
        """
        with self._may_be_bad():
            require_unchanged(self._path, self._version)
            self._reader.verify(stats)
            if self._hash is not None and self._hash.checksum is None:
                with pinned_version(self._path, self._version):
                    self._hash.finish(lambda start, size: read_range(self._path, start, size))
                require_unchanged(self._path, self._version)

    def take_hashed(self) -> PieceRuns:
        """See ``SurveyReader.take_hashed``."""
        return () if self._hash is None else self._hash.take()

    def put_hashed(self, pieces: PieceRuns) -> None:
        """See ``SurveyReader.put_hashed``."""
        if self._hash is not None:
            self._hash.put(pieces)

    def _require_unchanged(self) -> None:
        """Check the version of a local file; for a URL this would cost one more request for each chunk."""
        if not is_url(self._path):
            require_unchanged(self._path, self._version)

    @contextmanager
    def _may_be_bad(self) -> Iterator[None]:
        """Free memory if the file turns out to be bad."""
        try:
            yield
        except BadInputError:
            if self._hash is not None:
                self._hash.drop_copies()
            raise


class _Unhashed:
    """Bytes that were read for a chunk and are hashed later, by another thread, up to a limit."""

    def __init__(self, file_hash: FileHash) -> None:
        self._hash, self._size = file_hash, 0
        self._held: list[tuple[int, Any]] = []

    def add(self, start: int, data: Any) -> None:
        """Keep bytes, or hash them now if too many are kept."""
        self._size += len(data)
        if self._size > _MOST_HELD:
            self._hash.add(start, data)
        else:
            self._held.append((start, data))

    def finish(self) -> None:
        """Hash what is kept."""
        for start, data in self._held:
            self._hash.add(start, data)


_log = logging.getLogger(__name__)

Kind = Literal["las", "ply", "pcd"]
_READABLE = "bumpymap reads LAS, LAZ, COPC, PLY and PCD; scans are PLY, PCD, KITTI-style .bin or bags of ROS 2"
_HEAD = 1024

_FOREIGN = (
    (b"version https://git-lfs", "a Git LFS pointer, not the data itself. Fetch the data with: git lfs pull"),
    (b"ASTM-E57", "an E57 file. Convert it with: pdal translate --reader readers.e57 IN OUT.laz"),
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"II*\0", "a TIFF picture; a raster holds no points"),
    (b"MM\0*", "a TIFF picture; a raster holds no points"),
    (b"PK\x03\x04", "a ZIP archive (or .npz). Unpack it, or convert it"),
    (b"\x89MCAP", "a bag of ROS 2, which bumpymap scan reads"),
    (b"SQLite format 3", "an SQLite database. If it is a bag of ROS 2, name it .db3 for bumpymap scan"),
    (b"#ROSBAG", "a bag of ROS 1. Convert it to one of ROS 2 with rosbags-convert, for bumpymap scan"),
    (b"\x1f\x8b", "a gzip archive. Unpack it first"),
    (b"7z\xbc\xaf", "a 7z archive. Unpack it first"),
    (b"%PDF", "a PDF document"),
    (b"\x89HDF", "an HDF5 file"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"<", "an XML or HTML page; did a download give an error page?"),
    (b"{", "a JSON text"),
)
"""First bytes of other formats that users may pass by mistake."""


def open_survey(path: Location, options: ReadOptions = ReadOptions()) -> SurveyReader:  # noqa: B008 (frozen, no state)
    """Open a point cloud and check its header; points are read later. Notes about the file are logged as warnings.

    Parameters
    ----------
    path : Path or str
        A path, or a URL as a str.
    options : ReadOptions

    Returns
    -------
    SurveyReader

    Raises
    ------
    BadInputError
        The file cannot be read, is not a point cloud, holds no points, declares more than it can hold, or is not in
        a projected CRS.
    UsageError
        ``options.crs`` is not a CRS.
    """
    reader = reopen_survey(path, options)
    for note in reader.info.notes:
        _log.warning("%s: %s", path, note)
    return reader


def reopen_survey(path: Location, options: ReadOptions = ReadOptions()) -> SurveyReader:  # noqa: B008 (as above)
    """Open a point cloud as ``open_survey`` does, without logging its notes: for workers that open it again."""
    return VersionedSurvey(path, partial(_reader, path, options), checksum=options.checksum)


def _reader(path: Location, options: ReadOptions) -> "SurveyBase":
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
    """Read all points of a PLY or PCD file, opening it once.

    Parameters
    ----------
    path : Path
    wanted : dict of str to tuple of str
        Optional quantities beside x, y and z -> names, in lower case, of columns that may hold them.

    Returns
    -------
    dict of str to array (n,)
        x, y, z and the quantities that were found, by the keys of ``wanted``.

    Raises
    ------
    BadInputError
        The file cannot be read, is neither PLY nor PCD, declares more than it holds, or is damaged.
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
    """Return the format of a file by its first bytes.

    Raises
    ------
    BadInputError
        The file cannot be read, is empty, or is not a point cloud; the message says what it looks like.
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
    if Path(str(path)).suffix.lower() == ".label":
        raise BadInputError(f"{path} is a file of labels, not a scan: give the .bin file whose labels it holds")
    raise BadInputError(f"{path} is not a point cloud: it is {_describe(head)}. {_READABLE}")


def _is_pcd(head: bytes) -> bool:
    words = [line.split()[:1] for line in head.splitlines() if not line.startswith(b"#")]
    return head.startswith(b"# .PCD") or [b"VERSION"] in words[:2] or [b"FIELDS"] in words[:2]


def _describe(head: bytes) -> str:
    for start, what in _FOREIGN:
        if head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(start):
            return what
    if not head.strip(b"\0"):
        return "nothing but zero bytes, as an interrupted copy leaves it"
    if _is_text(head):
        return "a text file. A list of points under a first line 'X Y Z' is converted by: pdal translate IN.txt OUT.laz"
    return f"of an unknown kind (first bytes {head[:8].hex(' ')})"


def _is_text(head: bytes) -> bool:
    try:
        # Incremental: the last character may be truncated.
        text = getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return False
    return all(letter.isprintable() or letter in "\r\n\t" for letter in text)


SUFFIXES = (".las", ".laz", ".ply", ".pcd")
"""File suffixes that a folder is searched for, in any case (``.laz`` includes ``.copc.laz``)."""


def find_surveys(paths: Sequence[Location]) -> list[Location]:
    """Return the survey files at the given paths.

    Parameters
    ----------
    paths : sequence of Path or str
        Files (with any suffix) and folders, which are searched recursively for files with ``SUFFIXES``, except hidden
        ones. URLs, as str, may be files or folders too.

    Returns
    -------
    list of Path or str
        Sorted, URLs last; each file once.

    Raises
    ------
    BadInputError
        A path does not exist or cannot be listed, or a folder holds no surveys.
    """
    if not paths:
        raise BadInputError("no survey was given; name a point cloud file or a folder of them")
    found: dict[Path, Path] = {}
    remote: set[str] = set()
    for path in paths:
        if isinstance(path, str) and is_url(path):
            remote.update(_urls_of(path))
            continue
        try:
            for file in _files_of(Path(path)):
                found.setdefault(Path(os.path.realpath(file)), file)
        except OSError as error:
            raise BadInputError(f"cannot access {path}: {error.strerror}") from error
    return [*sorted(found.values()), *sorted(remote)]


def _urls_of(url: str) -> list[str]:
    # The server is only asked if the suffix does not decide: every request takes time.
    if url.lower().endswith(SUFFIXES) or not is_folder(url):
        return [url]
    return _some([name for name in list_folder(url) if name.lower().endswith(SUFFIXES)], url)


def _some(files: list[Any], folder: Location) -> list[Any]:
    if not files:
        raise BadInputError(
            f"the folder {folder} holds no point cloud; files ending in {', '.join(SUFFIXES)} are searched for, "
            "in its subfolders too. A file with another suffix can be given by its own path"
        )
    return files


def _files_of(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.is_dir():
        what = "is neither a file nor a folder" if path.exists() else "does not exist"
        raise BadInputError(f"{path} {what}; name a point cloud file or a folder of them")
    return _some(sorted(_walk(path)), path)


def _walk(folder: Path) -> Iterator[Path]:
    def refuse(error: OSError) -> None:
        raise BadInputError(f"cannot list the folder {error.filename}: {error.strerror}")

    for parent, folders, names in os.walk(folder, onerror=refuse):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in names:
            if not name.startswith(".") and name.lower().endswith(SUFFIXES):
                yield Path(parent) / name
