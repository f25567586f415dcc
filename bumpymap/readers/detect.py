"""Find the survey files that the user named, detect their format by content, not by suffix, and open them."""

import hashlib
import logging
import os
from codecs import getincrementaldecoder
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.protocol import ReadOptions, SurveyReader
from bumpymap.readers.source import EPT_NAME, Location, open_source, pinned_version, read_range, version_of

if TYPE_CHECKING:
    from bumpymap.readers.point_table import Wanted

_log = logging.getLogger(__name__)

Kind = Literal["las", "ply", "pcd", "tif"]
_READABLE = (
    "bumpymap reads LAS, LAZ, COPC, PLY, PCD and GeoTIFF (DSM); scans are PLY, PCD, KITTI-style .bin or bags of ROS 2"
)
_HEAD = 1024
"""Bytes at the start of a file that tell its format."""
_HEAD_BYTES = 65_536
"""Bytes at each end of a survey that its digest covers."""

_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of TIFF and BigTIFF."""
_FOREIGN = (
    (b"version https://git-lfs", "a Git LFS pointer, not the data itself. Fetch the data with: git lfs pull"),
    (b"ASTM-E57", "an E57 file. Convert it with: pdal translate --reader readers.e57 IN OUT.laz"),
    (b"PK\x03\x04", "a ZIP archive (or .npz). Unpack it, or convert it"),
    (b"\x89MCAP", "a bag of ROS 2, which bumpymap scan reads"),
    (b"SQLite format 3", "an SQLite database. If it is a bag of ROS 2, name it .db3 for bumpymap scan"),
    (b"#ROSBAG", "a bag of ROS 1. Convert it to one of ROS 2 with rosbags-convert, for bumpymap scan"),
    (b"\x1f\x8b", "a gzip archive. Unpack it first"),
    (b"<", "an XML or HTML page; did a download give an error page?"),
)
"""First bytes of other formats that users may pass by mistake."""


def open_survey(path: Location, options: ReadOptions = ReadOptions()) -> SurveyReader:  # noqa: B008 (frozen, no state)
    """Open a point cloud and check its header; points are read later. Notes about the file are logged as warnings.

    Raises BadInputError: the file cannot be read, is not a point cloud, holds no points, declares
    more than it can hold, or is not in a projected CRS; UsageError: ``options.crs`` is not a CRS.
    """
    reader = reopen_survey(path, options)
    reader.note_likely_feet()
    for note in reader.info.notes:
        _log.warning("%s: %s", path, note)
    return reader


def reopen_survey(path: Location, options: ReadOptions = ReadOptions()) -> SurveyReader:  # noqa: B008 (as above)
    """Open a point cloud as ``open_survey`` does, without logging its notes: for workers that open it again."""
    kind = detect_format(path)
    if kind == "las":
        from bumpymap.readers.las import LasSurvey

        return LasSurvey(path, options)
    if kind == "tif":
        from bumpymap.readers.raster import RasterSurvey

        return RasterSurvey(path, options)
    from bumpymap.readers.point_table import TableSurvey

    return TableSurvey(path, options, kind)


def identity(location: Location) -> dict[str, Any]:
    """Return what identifies a survey and its version. For one that is being read, see `require_unchanged`.

    Returns a `Version` (``size`` in bytes, and ``mtime_ns`` as str) and ``digest``: SHA-256
    of the first and the last 64 KiB.
    """
    version = version_of(location)
    with pinned_version(location, version):
        starts = (0, max(version["size"] - _HEAD_BYTES, 0))
        ends = [read_range(location, start, _HEAD_BYTES).tobytes() for start in starts]
    return {**version, "digest": hashlib.sha256(b"".join(ends)).hexdigest()}


def read_columns(path: Path, wanted: "Wanted") -> dict[str, NDArray[Any]]:
    """Read all points of a PLY or PCD file.

    ``wanted``: optional quantities beside x, y and z -> names, in lower case, of columns that may
    hold them. Returns arrays (n,): x, y, z and the quantities that were found, by the
    keys of ``wanted``. Raises BadInputError: the file cannot be read, is neither PLY nor PCD,
    declares more than it holds, or is damaged.
    """
    kind = detect_format(path)
    if kind in {"las", "tif"}:
        raise BadInputError(
            f"{path} is a survey ({kind.upper()}) and not a scan of a robot; scans are PLY, PCD or KITTI-style .bin "
            "files. Map a survey with: bumpymap map"
        )
    from bumpymap.readers.point_table import open_table

    table = open_table(kind, path, wanted, ReadOptions().memory, np.float64)
    rows = table.whole()
    return {what: rows[name] for what, name in table.info.find(wanted).items()}


def detect_format(path: Location) -> Kind:
    """Return the format of a file by its first bytes.

    Raises BadInputError: the file cannot be read, is empty, or is not a point cloud; the message
    says what it looks like.
    """
    if path.name == EPT_NAME:
        raise _ept_error(path)
    with open_source(path) as stream:
        head = stream.read(_HEAD)
    if not head:
        raise BadInputError(f"{path} is empty (0 bytes). Copy or download it again")
    if head.startswith(b"LASF"):
        return "las"
    if head.startswith(_TIFF):
        return "tif"
    if head.split(None, 1)[:1] == [b"ply"]:
        return "ply"
    words = [line.split()[:1] for line in head.splitlines() if not line.startswith(b"#")]
    if head.startswith(b"# .PCD") or [b"VERSION"] in words[:2] or [b"FIELDS"] in words[:2]:
        return "pcd"
    if Path(str(path)).suffix.lower() == ".label":
        raise BadInputError(f"{path} is a file of labels, not a scan: give the .bin file whose labels it holds")
    raise BadInputError(f"{path} is not a point cloud: it is {_describe(head)}. {_READABLE}")


def _describe(head: bytes) -> str:
    for start, what in _FOREIGN:
        if head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(start):
            return what
    if not head.strip(b"\0"):
        return "nothing but zero bytes, as an interrupted copy leaves it"
    with suppress(UnicodeDecodeError):
        text = getincrementaldecoder("utf-8")().decode(head)  # incremental: the last character may be truncated
        if all(letter.isprintable() or letter in "\r\n\t" for letter in text):
            return (
                "a text file. A list of points under a first line 'X Y Z' is converted by: pdal translate IN.txt "
                "OUT.laz"
            )
    return f"of an unknown kind (first bytes {head[:8].hex(' ')})"


SUFFIXES, RASTERS = (".las", ".laz", ".ply", ".pcd"), (".tif", ".tiff")
"""File suffixes that a folder is searched for, in any case (``.laz`` includes ``.copc.laz``); for those of rasters only
if it holds no other survey, since an orthophoto is a TIFF too."""
_MAP = "run.json"
"""In a folder of layers that bumpymap has made: its rasters are no surveys."""
_ODM = (
    *("odm_georeferencing/odm_georeferenced_model.laz", "odm_georeferencing/odm_georeferenced_model.las"),
    "odm_dem/dsm.tif",
)
"""Where a project of ODM has its survey; the first one that is there is taken."""
_ODM_PHOTO = "odm_orthophoto/odm_orthophoto.tif"


def project_survey(folder: Path) -> Path | None:
    """Return the survey of a project of OpenDroneMap (ODM) by its known place; None if the folder is none."""
    return next((path for name in _ODM if (path := folder / name).is_file()), None)


def project_photo(paths: Sequence[Path]) -> Path | None:
    """Return the orthophoto of the only path, if that is a project of ODM which has one."""
    photo = Path(paths[0]) / _ODM_PHOTO if len(paths) == 1 else None
    return photo if photo is not None and photo.is_file() and project_survey(Path(paths[0])) is not None else None


def find_surveys(paths: Sequence[Location]) -> list[Location]:
    """Return the survey files at the given paths.

    ``paths``: files (with any suffix) and folders, which are searched recursively for files with ``SUFFIXES`` or
    ``RASTERS``, except hidden ones; of a project of ODM, see `project_survey`. Returns them sorted, each once. Raises
    BadInputError: a path does not exist or cannot be listed, or a folder holds no surveys, or an EPT.
    """
    if not paths:
        raise BadInputError("no survey was given; name a point cloud file or a folder of them")
    return sorted(files_at(map(Path, paths), _surveys_in, "a point cloud file"))


def files_at(paths: Iterable[Path], list_folder: Callable[[Path], list[Path]], what: str) -> list[Path]:
    """Return the files at some paths, each once: those that are given, and those that ``list_folder`` finds in folders.

    Raises BadInputError: a path does not exist, is neither file nor folder, or cannot be listed; the message asks for
    ``what`` instead, such as "a file of a scan".
    """
    found: dict[str, Path] = {}
    for path in paths:
        try:
            if not (path.is_file() or path.is_dir()):
                fault = "is neither a file nor a folder" if path.exists() else "does not exist"
                raise BadInputError(f"{path} {fault}; name {what} or a folder of them")
            for file in [path] if path.is_file() else list_folder(path):
                found.setdefault(os.path.realpath(file), file)
        except OSError as error:
            raise BadInputError(f"cannot access {path}: {error.strerror}") from error
    return [*found.values()]


def rasters_beside(paths: Sequence[Path]) -> list[Path]:
    """Return the rasters in folders among the paths that are no surveys, because the folder holds point clouds."""
    found = [_clouds_and_rasters(path) for path in paths if path.is_dir()]
    return sorted(raster for clouds, rasters in found if clouds for raster in rasters)


def _surveys_in(folder: Path) -> list[Path]:
    """Return the surveys in a folder and its subfolders, sorted; BadInputError without any."""
    clouds, rasters = _clouds_and_rasters(folder)
    if not (clouds or rasters):
        raise BadInputError(
            f"the folder {folder} holds no point cloud and no DSM; files ending in {', '.join((*SUFFIXES, *RASTERS))} "
            "are searched for, in its subfolders too. A file with another suffix can be given by its own path"
        )
    return sorted(clouds or rasters)


def _clouds_and_rasters(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the point clouds, with the surveys of projects, and other rasters in a folder and its subfolders."""

    def refuse(error: OSError) -> None:
        raise BadInputError(f"cannot list the folder {error.filename}: {error.strerror}")

    found: list[Path] = []
    rasters: list[Path] = []
    for parent, folders, names in os.walk(folder, onerror=refuse):
        if (survey := project_survey(Path(parent))) is not None:
            folders.clear()
            found.append(survey)
            continue
        if EPT_NAME in names:
            raise _ept_error(Path(parent) / EPT_NAME)
        folders[:] = [name for name in folders if not name.startswith(".")]
        files = [Path(parent) / name for name in names if not name.startswith(".")]
        found += [path for path in files if path.name.lower().endswith(SUFFIXES)]
        if not any((place / _MAP).exists() for place in (Path(parent), Path(parent).parent)):
            rasters += [path for path in files if path.name.lower().endswith(RASTERS)]
    return found, rasters


def _ept_error(path: Path) -> BadInputError:
    return BadInputError(
        f"{path} is an EPT, which is not read. Write it as one file: pdal translate --reader readers.ept {path} "
        "OUT.copc.laz"
    )
