"""Find the frames that the user named, in time order."""

import os
import re
from collections.abc import Sequence
from pathlib import Path

from bumpymap.core import BadInputError, FrameSource, UsageError
from bumpymap.readers.frames.bag import BAG_SUFFIXES, is_bag
from bumpymap.readers.frames.bag_frames import BagTopics, find_messages
from bumpymap.readers.frames.kitti import POINT_FOLDERS

__all__ = ["SUFFIXES", "bags_at", "find_frames", "find_sources", "natural_key"]

SUFFIXES = (".ply", ".pcd", ".bin")
"""File suffixes that a folder is searched for, in any case."""
_NUMBER = re.compile(r"(\d+)")


def find_sources(paths: Sequence[Path], topics: BagTopics) -> list[FrameSource]:
    """Return the scans at the given paths, in time order: files, as by `find_frames`, or messages in bags.

    Parameters
    ----------
    paths : sequence of Path
        Files and folders of scans, or bags (``.mcap``, ``.db3``, folders with ``metadata.yaml`` or with such files).
    topics : BagTopics
        For bags alone.

    Returns
    -------
    list of FrameSource
        Several bags in natural order of their paths.

    Raises
    ------
    BadInputError
        A path does not exist, holds no scans, or a bag cannot be read or leaves open which topic is meant.
    UsageError
        Topics are given without a bag, bags are mixed with files of scans, or the extra ``ros`` is not installed.
    """
    bags = [bag for path in paths for bag in bags_at(path)]
    if not bags:
        if (topics.cloud, topics.odometry) != (None, None):
            raise UsageError("`topic` and `odometry` choose topics of a bag, and no bag was given; leave them out")
        return [FrameSource(path) for path in find_frames(paths)]
    files = [path for path in paths if not bags_at(path)]
    if files:
        raise UsageError(f"{files[0]} and {bags[0]} were given; give files of scans or bags, not both")
    unique = {os.path.realpath(bag): bag for bag in reversed(bags)}
    return find_messages(sorted(unique.values(), key=natural_key), topics)


def bags_at(path: Path) -> list[Path]:
    """Return the bags at a path: itself, or the files of bags in a folder that lost its metadata; else none."""
    if path.suffix.lower() == ".bag" and path.is_file():
        raise BadInputError(f"{path} is a bag of ROS 1; convert it to one of ROS 2 first, with rosbags-convert")
    if is_bag(path):
        return [path] if path.exists() else []
    if not path.is_dir() or _scans(path):
        return []
    return [file for file in path.iterdir() if file.suffix.lower() in BAG_SUFFIXES and file.is_file()]


def find_frames(paths: Sequence[Path]) -> list[Path]:
    """Return the scan files at the given paths, in time order.

    Parameters
    ----------
    paths : sequence of Path
        Files (with any suffix) and folders. If a folder holds no scans itself, its subfolder ``velodyne`` or
        ``os1_cloud_node_kitti_bin`` is searched, as in the KITTI and RELLIS-3D data sets. Hidden files are ignored.

    Returns
    -------
    list of Path
        In natural order of their paths (``2.bin`` before ``10.bin``), whatever the order of ``paths``; each once.

    Raises
    ------
    BadInputError
        A path does not exist, or a folder holds no scans or scans of several formats.
    """
    if not paths:
        raise BadInputError("no scan was given; name a file of a scan, or a folder of them")
    found: dict[str, Path] = {}
    for path in paths:
        try:
            for file in _files_of(path):
                found.setdefault(os.path.realpath(file), file)
        except OSError as error:
            raise BadInputError(f"cannot access {path}: {error.strerror}") from error
    return sorted(found.values(), key=natural_key)


def natural_key(path: Path) -> tuple[tuple[tuple[int, int | str], ...], ...]:
    """Return a sort key that compares numbers in names as numbers, and puts a folder before its contents."""
    return tuple(
        tuple((0, int(part)) if part.isdigit() else (1, part) for part in _NUMBER.split(name) if part)
        for name in path.parts
    )


def _files_of(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.is_dir():
        what = "is neither a file nor a folder" if path.exists() else "does not exist"
        raise BadInputError(f"{path} {what}; name a file of a scan or a folder of them")
    for folder in (path, *(path / name for name in POINT_FOLDERS)):
        files = _scans(folder)
        kinds = sorted({file.suffix.lower() for file in files})
        if len(kinds) > 1:
            raise BadInputError(
                f"the folder {folder} holds scans of several formats ({', '.join(kinds)}): the same frames twice? Name "
                f"the files of one format, such as: {folder}/*{kinds[0]}"
            )
        if files:
            return files
    raise BadInputError(
        f"the folder {path} holds no scans; files ending in {', '.join(SUFFIXES)} are searched for, also in its "
        f"folders {' and '.join(POINT_FOLDERS)}, and bags ({', '.join(BAG_SUFFIXES)}). Name the folder that holds them"
    )


def _scans(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return [
        file
        for file in folder.iterdir()
        if file.suffix.lower() in SUFFIXES and not file.name.startswith(".") and file.is_file()
    ]
