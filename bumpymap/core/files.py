"""Files: written whole under a temporary name in the target folder; JSON of strangers, safe CSV, and PLY.

JSON of untrusted files is parsed with a limit on the nesting depth, and checked against a declared shape.
"""

import csv
import errno
import json
import math
import os
import shlex
import shutil
import stat
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from uuid import uuid4

from bumpymap.core.errors import OutputError, escape_controls, write_remedy

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MOST_SHOWN = 200
"""Characters of the name of a value that a message shows."""
_DEEPEST = 50
"""Deeper than any file that bumpymap writes."""


def parse_json(text: str) -> Any:
    """Parse JSON text.

    Raises ValueError: not JSON, or nested more than 50 deep.
    """
    with suppress(RecursionError):
        value = json.loads(text)
        level = [value]
        for _ in range(_DEEPEST):
            held = (own.values() if isinstance(own, dict) else own for own in level if isinstance(own, dict | list))
            level = [child for children in held for child in children if isinstance(child, dict | list)]
            if not level:
                return value
    raise ValueError(f"it is nested more than {_DEEPEST} deep")


def plain_json(value: Any, digits: int | None = None) -> Any:
    """Convert dataclasses, arrays, paths and CRSs, nested in any way, to types that JSON has.

    Numbers that are not finite become None, others are rounded to ``digits`` significant ones.
    """
    if hasattr(value, "tolist"):
        value = value.tolist()
    elif is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, Mapping):
        return {str(key): plain_json(item, digits) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(item, digits) for item in value]
    if isinstance(value, float):
        return None if not math.isfinite(value) else value if digits is None else float(f"{value:.{digits}g}")
    return value if value is None or isinstance(value, bool | int | str) else str(value)


@dataclass(frozen=True, slots=True)
class Number:
    """A finite number, or a whole one, within bounds."""

    low: float = -1e300
    high: float = 1e300
    whole: bool = False

    def __str__(self) -> str:
        return f"a {'whole ' if self.whole else ''}number from {self.low:g} to {self.high:g}"


@dataclass(frozen=True, slots=True)
class Nullable:
    """A value of a shape, or null."""

    shape: Any


@dataclass(frozen=True, slots=True)
class Each:
    """An object of any names, each with a value of a shape."""

    shape: Any = object


def shape_fault(value: Any, shape: Any, name: str = "it") -> str:
    """Return what is wrong with a value of JSON, or an empty string.

    ``value``: from `parse_json`; ``shape``: ``{name: shape}`` for an object, which may hold more (a name that ends in
    ``?`` may be missing); ``[shape]`` for an array; ``(shape, shape)`` for one of that length; `Number`, `Nullable`,
    `Each`; else a type; ``name``: how the message calls the value.
    """
    if isinstance(shape, Nullable):
        return "" if value is None else shape_fault(value, shape.shape, name)
    inner: Iterable[tuple[Any, Any, Any]] = ()
    if isinstance(shape, Number):
        is_number = isinstance(value, int if shape.whole else int | float) and not isinstance(value, bool)
        good, wanted = is_number and shape.low <= value <= shape.high, str(shape)
    elif isinstance(shape, dict):
        names = [key for key in shape if not key.endswith("?")]
        good, wanted = isinstance(value, dict) and set(names) <= set(value), f"an object with {', '.join(names)}"
        named = {key.removesuffix("?"): each for key, each in shape.items()}
        inner = ((key, value[key], each) for key, each in named.items() if key in value)
    elif isinstance(shape, Each):
        good, wanted = isinstance(value, dict), "an object"
        inner = ((key, entry, shape.shape) for key, entry in (value.items() if good else ()))
    elif isinstance(shape, list | tuple):
        fixed = isinstance(shape, tuple)
        good = isinstance(value, list) and not (fixed and len(value) != len(shape))
        wanted = f"an array of {len(shape)}" if fixed else "an array"
        inner = ((at, entry, shape[at if fixed else 0]) for at, entry in enumerate(value if good else ()))
    else:
        good, wanted = isinstance(value, shape), {str: "text", bool: "true or false"}.get(shape, "")
    if not good:
        return f"{name[:_MOST_SHOWN]} is {str(value)[:40]!r}; it must be {wanted}"
    within = "" if name == "it" else f"{name}."
    return next(filter(None, (shape_fault(entry, each, f"{within}{key}") for key, entry, each in inner)), "")


STAGED = ".bumpymap-layers-"
"""Name prefix of staging folders, from which files are moved together; one left by a killed process can be deleted."""
_SIDECAR = ".aux.xml"
"""Suffix of GDAL's sidecar file: category names, and a CRS that GeoTIFF keys cannot express."""


_MOST_READ = 1 << 28
"""Bytes of the largest file that `read_regular` reads."""


def open_regular(path: Path, flags: int = 0) -> BinaryIO:
    """Open a file that a user names, to read it; ``flags`` are those of `os.open`.

    Raises OSError: it cannot be read, or is a pipe or a device: that might never end. ``strerror`` says so.
    """
    more = flags | os.O_NONBLOCK
    file = open(path, "rb", opener=lambda name, own: os.open(name, own | more))  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "it is a pipe or a device; write what it holds to a file", str(path))
    return file


def read_regular(path: Path, most: int = _MOST_READ) -> bytes:
    """Return the content of a file that a user names, of ``most`` bytes at most; for errors see `open_regular`."""
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        size = f"{most >> 20} MB" if most >= 1 << 20 else f"{most >> 10} kB"
        raise OSError(errno.EFBIG, f"it has more than {size}, the most that is read", str(path))
    return content


@contextmanager
def atomic(target: Path, failures: tuple[type[Exception], ...] = ()) -> Iterator[Path]:
    """Yield a temporary path to write to, and rename it to ``target`` if the body succeeds.

    The path lies in the same folder as ``target`` and has the same suffix. Other files whose names start with its stem
    are scratch files and are always removed. A GDAL sidecar file moves along with its raster; one that belongs to an
    earlier raster is removed, since it would describe the wrong pixels. ``target``: the file to create or replace;
    ``failures``: what the writing library raises if it cannot write, in addition to ``OSError``. Raises OutputError:
    the file could not be written. ``target`` is unchanged.
    """
    temporary = target.with_name(f".{target.stem}.{uuid4().hex}{target.suffix}")
    try:
        yield temporary
        _move(temporary, target)
    except (OSError, *failures) as error:  # type: ignore[misc]
        raise OutputError(
            f"cannot write {target}: {error}. "
            f"{write_remedy(error, 'Free some space, or choose a folder that can be written, with `out`')}; "
            "nothing half-written was left there"
        ) from error
    finally:
        # Not by a pattern: Python would keep each one compiled.
        for left in list(target.parent.iterdir()) if target.parent.is_dir() else []:
            if left.name.startswith(temporary.stem):
                left.unlink(missing_ok=True)


@contextmanager
def write_together(folder: Path, last: str, earlier: Collection[str] = ()) -> Iterator[Path]:
    """Yield an empty folder to write files to; at the end all of them move to ``folder``, or none.

    Files that they replace stay until all are complete. The file ``last`` moves last, and an old one is removed first,
    so that its presence means that all others are there, even if the process is killed between two moves. The GDAL
    sidecar file of a replaced raster is removed too, since it would describe the wrong pixels. ``folder``: an existing
    folder; ``last``: name of the file that marks the set as complete; ``earlier``: files that an earlier run may have
    left, relative to ``folder``. Those that are not written again are removed. Raises OutputError: the files could not
    be moved. The folder is unchanged.
    """
    staged = folder / f"{STAGED}{uuid4().hex}"
    try:
        with writing_to(folder):
            staged.mkdir(mode=0o700)
        with utf8_path(staged) as path:
            yield path
        move_together(staged, folder, last, earlier)
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def remove_path(path: Path, folder: int | None = None) -> None:
    """Remove a file, a folder with its contents, or a link (never its target).

    ``folder``: descriptor of the folder that ``path`` is relative to. Raises OSError: it does not exist, or cannot be
    removed.
    """
    if stat.S_ISDIR(os.stat(path, dir_fd=folder, follow_symlinks=False).st_mode):
        shutil.rmtree(path, dir_fd=folder)  # checks again, and follows no link
    else:
        os.unlink(path, dir_fd=folder)


@contextmanager
def remove_empty_on_error(folder: Path) -> Iterator[None]:
    """Remove the folder if the body fails, provided that the body created it and left it empty."""
    created = not folder.exists()
    try:
        yield
    except BaseException:
        if created:
            with suppress(OSError):  # not empty
                folder.rmdir()
        raise


@contextmanager
def utf8_path(folder: Path) -> Iterator[Path]:
    """Yield a path to the folder that is valid UTF-8, as GDAL and Arrow require.

    If the folder's own path is not, the path goes through an open descriptor in ``/proc/self/fd``.
    """
    try:
        str(folder).encode()
    except UnicodeEncodeError:
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            yield Path(f"/proc/self/fd/{descriptor}")
        finally:
            os.close(descriptor)
    else:
        yield folder


@contextmanager
def writing_to(folder: Path, options: str = "`out`") -> Iterator[None]:
    """Turn an OSError in the body into an OutputError; ``options`` are the settings that choose another folder."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"cannot write to the folder {folder}: {error.strerror or error}. Choose another with {options}"
        ) from error


def move_together(staged: Path, folder: Path, last: str, earlier: Collection[str] = ()) -> None:
    """Move all files of ``staged`` to ``folder``, or none; see `write_together`. Links are replaced, never followed.

    A folder in ``staged`` moves as one. Into a folder that ``earlier`` names files of, which must not be a link, the
    files move one by one, so that others in it stay.
    """
    parts = sorted({Path(), *(Path(name).parent for name in earlier)})
    new = {path.relative_to(staged) for part in parts for path in (staged / part).glob("*")} - {*parts}
    every = {name.with_name(name.name + end) for name in (*new, *map(Path, earlier)) for end in ("", _SIDECAR)}
    aside, final = staged / "old", Path(last)
    done: list[tuple[str, str, int | None, int | None]] = []
    with ExitStack() as stack:
        try:
            opened, there = {}, set()
            for part in parts:
                (aside / part).mkdir()
                opened[part] = stack.enter_context(_opened_part(folder, part))
                there |= {part / name for name in os.listdir(opened[part])}  # noqa: PTH208 (takes a descriptor)
            old = sorted(every & there, key=lambda name: (name != final, name))
            out = [(name.name, str(aside / name), opened[name.parent], None) for name in old]
            names = sorted(new, key=lambda name: (name == final, name))
            into = [(str(staged / name), name.name, None, opened[name.parent]) for name in names]
            for source, target, source_folder, target_folder in [*out, *into]:
                os.replace(source, target, src_dir_fd=source_folder, dst_dir_fd=target_folder)
                done.append((source, target, source_folder, target_folder))
            for descriptor in opened.values():
                os.fsync(descriptor)
        except BaseException as error:
            for source, target, source_folder, target_folder in reversed(done):
                os.replace(target, source, src_dir_fd=target_folder, dst_dir_fd=source_folder)
            if not isinstance(error, OSError):
                raise
            raise OutputError(
                f"cannot move the new files to {folder}: {error}. Nothing was replaced; choose another `out`"
            ) from error


@contextmanager
def _opened_part(folder: Path, part: Path) -> Iterator[int]:
    """Yield the descriptor of a folder, or of one in it that is no link, made if missing and removed if left empty."""
    place, is_inside = folder / part, bool(part.parts)
    place.mkdir(exist_ok=True)
    descriptor = os.open(place, os.O_RDONLY | os.O_DIRECTORY | (os.O_NOFOLLOW if is_inside else 0))
    try:
        yield descriptor
    finally:
        os.close(descriptor)
        if is_inside:
            with suppress(OSError):  # it holds files
                place.rmdir()


def _move(temporary: Path, target: Path) -> None:
    side, old_side = (path.with_name(path.name + _SIDECAR) for path in (temporary, target))
    sync_file(temporary)
    old_side.unlink(missing_ok=True)
    os.replace(temporary, target)  # noqa: PTH105 (os.replace says that it overwrites)
    if side.exists():
        sync_file(side)
        os.replace(side, old_side)  # noqa: PTH105
    if not any(part.startswith(STAGED) for part in target.parts):  # what is staged is moved, and its new folder synced
        descriptor = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def sync_file(path: Path) -> None:
    """Flush a file to the disk."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def install_command(extra: str) -> str:
    """Return the command that adds an extra of this package to this environment."""
    return f"{shlex.quote(sys.executable)} -m pip install '.[{extra}]' in the folder of the repository"


_FORMULA = tuple("=+-@\uff1d\uff0b\uff0d\uff20")
"""First characters of formulas, in both widths."""


def write_csv(path: Path, columns: Iterable[str], rows: Iterable[Sequence[Any]], *, end: str = "\r\n") -> None:
    """Write a table as CSV (RFC 4180, UTF-8) that a spreadsheet can open safely.

    ``path``: the file, which appears only when it is complete; ``rows``: numbers, and text that is one, stay as they
    are. Other text is escaped, with an apostrophe before what would be a formula. None is an empty cell. ``end``: of a
    line. Raises OutputError: the file cannot be written.
    """
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator=end)
        writer.writerow(columns)
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return "true" if value else "false"
    if not isinstance(value, str):
        return value
    text = escape_controls(value)
    if not text.lstrip().startswith(_FORMULA):
        return text
    with suppress(ValueError):
        float(text)
        return text
    return f"'{text}"


_PLY_NAMES = {
    "i1": ("char", "int8"),
    "u1": ("uchar", "uint8"),
    "i2": ("short", "int16"),
    "u2": ("ushort", "uint16"),
    "i4": ("int", "int32"),
    "u4": ("uint", "uint32"),
    "f4": ("float", "float32"),
    "f8": ("double", "float64"),
}
"""NumPy type code without byte order -> type name, and the name that newer files use."""
PLY_TYPES = {name: code for code, names in _PLY_NAMES.items() for name in names}
"""Type name in a header -> NumPy type code without byte order."""


def write_vertices(vertex: "NDArray[Any]", comments: Sequence[str], stream: BinaryIO) -> None:
    """Write points as binary little-endian PLY, one element ``vertex``.

    ``vertex`` (n,): each field becomes a property; its type must be one of ``PLY_TYPES``, in any byte order;
    ``comments``: one line each, ASCII.
    """
    kinds = [(name, vertex.dtype[name].str[1:]) for name in vertex.dtype.names or ()]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    lines += [f"element vertex {len(vertex)}", *(f"property {_PLY_NAMES[code][0]} {name}" for name, code in kinds)]
    stream.write("\n".join([*lines, "end_header", ""]).encode("ascii"))
    stream.write(vertex.astype([(name, f"<{code}") for name, code in kinds], copy=False).tobytes())
