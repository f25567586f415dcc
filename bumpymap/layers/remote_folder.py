"""A folder of layers on a server, such as ``s3://bucket/night/site``: uploaded whole, run.json last."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bumpymap.core import BadInputError, BumpymapError, OutputError, UsageError, parse_json, remote_files, utf8_path
from bumpymap.layers.manifest import MANIFEST_NAME
from bumpymap.layers.map_files import open_layer
from bumpymap.layers.sheets.folders import raster_in

__all__ = ["RemoteFolder", "open_raster"]


@dataclass(frozen=True, slots=True)
class RemoteFolder:
    """A folder by its URL. Nothing is downloaded but what is read."""

    url: str

    def below(self, name: str) -> "RemoteFolder":
        """Return a folder in this one; raise UsageError if the name would end the path of the URL, as ``::`` does."""
        if "::" in name:
            raise UsageError(
                f"the folder {name} cannot be on a server: in the URL of a file, :: ends its path. Rename the survey, "
                "or name it in the column name of a CSV"
            )
        return RemoteFolder(f"{self.url.rstrip('/')}/{name}")

    def sizes(self) -> dict[str, int]:
        """Return the sizes of the files in the folder by name, bytes; empty if there is no such folder.

        Raises
        ------
        OutputError
            The server cannot be used.
        """
        with self._using("read") as (files, path):
            files.invalidate_cache()
            try:
                found = files.ls(path, detail=True)
            except FileNotFoundError:
                return {}
            return {entry["name"].rsplit("/", 1)[-1]: entry["size"] for entry in found if entry["type"] == "file"}

    def read(self, name: str) -> bytes | None:
        """Return the bytes of a file; None if there is none. Raises OutputError if the server cannot be used."""
        with self._using("read", name) as (files, path):
            try:
                data: bytes = files.cat_file(path)
            except FileNotFoundError:
                return None
            return data

    def manifest(self) -> dict[str, Any] | None:
        """Return what run.json says; None if there is none, or none that can be read."""
        data = self.read(MANIFEST_NAME)
        try:
            record = parse_json((data or b"").decode())
        except ValueError:
            return None
        return record if isinstance(record, dict) else None

    def upload(self, folder: Path, last: str) -> None:
        """Upload all files of a folder but hidden ones; ``last`` at the end, so that its presence means all are there.

        One of that name that is there already is removed first. Links are left out.

        Raises
        ------
        OutputError
            The server cannot be used, or refuses a file.
        """
        names = sorted(
            path.name
            for path in folder.iterdir()
            if path.is_file() and not path.is_symlink() and not path.name.startswith(".") and path.name != last
        )
        present = self.sizes()
        with self._using("write") as (files, path):
            if last in present:
                files.rm_file(f"{path}/{last}")
            _make_folder(files, path)
        for name in (*names, last):
            with self._using("write", name) as (files, path):
                files.put_file(str(folder / name), path)

    @contextmanager
    def _using(self, what: str, name: str = "") -> Iterator[tuple[Any, str]]:
        """Yield the file system and the path of a file in the folder; turn its exceptions, which differ, into one."""
        url = f"{self.url.rstrip('/')}/{name}" if name else self.url
        try:
            files, path = remote_files(url)
            yield files, path.rstrip("/")
        except (BumpymapError, MemoryError):
            raise
        except Exception as error:
            said = str(error).strip() or type(error).__name__
            raise OutputError(f"cannot {what} {url}: {said}. Check the address and the access rights") from error


@contextmanager
def open_raster(folder: Path | RemoteFolder, name: str) -> Iterator[Any]:
    """Open a raster of a map, the virtual one if it is in sheets; on a server, only the parts that are used are read.

    Raises
    ------
    BadInputError
        It is missing or damaged.
    """
    import rasterio

    try:
        if isinstance(folder, RemoteFolder):
            url = folder.below(name).url
            files, _ = remote_files(url)
            with open_layer(url, files) as raster:
                yield raster
        else:
            with utf8_path(folder) as path, open_layer(raster_in(path, name)) as raster:
                yield raster
    except (rasterio.errors.RasterioIOError, OSError) as error:
        place = folder.url if isinstance(folder, RemoteFolder) else folder
        raise BadInputError(f"{place}/{name} cannot be read: {error}") from error


def _make_folder(files: Any, path: str) -> None:
    """Make a folder and the one that it is in, where the file system has folders; never a bucket."""
    parts = path.split("/")
    for folder in ("/".join(parts[:-1]), path):
        if "/" in folder.strip("/") and not files.exists(folder):
            files.mkdir(folder, create_parents=False)
