"""Files that are something else, and things that are no files."""

import io
import os
import socket
import zipfile

import numpy as np

from .bases import bases
from .case import Case


def foreign_cases():
    """Every case of a file that is no point cloud, under the name of one."""
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"a" * 64 + b"\nsize 132735411\n"
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr(zipfile.ZipInfo("site.las"), bases()["las12.las"])
    rng = np.random.default_rng(5)
    held = {
        "lfs_pointer.laz": pointer,
        "lfs_pointer.ply": pointer,
        "page.las": b"<!DOCTYPE html><html><body>404 Not Found</body></html>",
        "empty.laz": b"",
        "one_byte.las": b"L",
        "signature_alone.las": b"LASF",
        "zeros.laz": bytes(100_000),
        "zeros_behind_signature.laz": b"LASF" + bytes(100_000),
        "ones_behind_signature.las": b"LASF" + b"\xff" * 100_000,
        "random.laz": rng.bytes(50_000),
        "random_behind_signature.las": b"LASF" + rng.bytes(50_000),
        "random_behind_ply.ply": b"ply\n" + rng.bytes(50_000),
        "random_behind_pcd.pcd": b"# .PCD v0.7\n" + rng.bytes(50_000),
        "archive.laz": packed.getvalue(),
        "gzip.las": b"\x1f\x8b\x08\0" + rng.bytes(300),
        "table.ply": b"X Y Z\n1 2 3\n",
        "json.pcd": b'{"type": "FeatureCollection"}',
        "utf16.ply": "ply\nformat ascii 1.0\n".encode("utf-16"),
        "crlf_mangled.laz": bases()["laz12.laz"].replace(b"\n", b"\r\n"),
        "twice.ply": b"ply\n" * 2000,
    }
    return [Case(f"foreign-{name}", data) for name, data in held.items()]


def _folder(place):
    path = place / "x.laz"
    path.mkdir()
    return path


def _full_folder(place):
    """A folder that holds a bad file."""
    path = place / "x.las"
    path.mkdir()
    (path / "inner.laz").write_bytes(b"LASF")
    return path


def _fifo(place):
    path = place / "x.laz"
    os.mkfifo(path)
    return path


def _fifo_in_folder(place):
    os.mkfifo(place / "x.laz")
    return place


def _socket(place):
    path = place / "x.laz"
    with socket.socket(socket.AF_UNIX) as end:
        end.bind(os.path.relpath(path))  # the name of a socket has at most a hundred letters
    return path


def _link(target):
    def make(place):
        path = place / "x.laz"
        path.symlink_to(target)
        return path

    return make


def _missing(place):
    return place / "x.laz"


def _named(name):
    def make(place):
        path = place / name
        path.write_bytes(bases()["laz12.laz"][:1000])
        return path

    return make


PLACES = {
    "folder": _folder,
    "folder_of_a_bad_file": _full_folder,
    "fifo": _fifo,
    "fifo_in_folder": _fifo_in_folder,
    "socket": _socket,
    "missing": _missing,
    "dangling_link": _link("nowhere.laz"),
    "circular_link": _link("x.laz"),
    "link_to_zeros": _link("/dev/zero"),
    "link_to_terminal": _link("/dev/tty"),
    "name_with_newline": _named("a\nb.laz"),
    "name_with_markup": _named("[red]%s{x}[bold].laz"),
    "name_not_utf8": _named(os.fsdecode(b"caf\xe9.laz")),
    "name_like_an_option": _named("-v.laz"),
    "longest_name": _named("a" * 250 + ".laz"),
}
"""What is no regular file, or has an odd name: a function of a folder gives the path."""
