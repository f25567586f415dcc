"""File systems of servers, by URL. fsspec is imported only if a URL is used."""

import hashlib
import re
from pathlib import Path
from typing import Any

from bumpymap.core.errors import UsageError

__all__ = ["recorded_place", "remote_files", "without_keys"]

_INSTALL = "pip install 'bumpymap[remote]'"
_URL = re.compile(r"""(\w+://)(?:[^/\s@'"]*@)?([^\s?'"]*)(?:\?[^\s'"]*[^\s'":.,)])?""")
"""Protocol, user, server and path, query."""


def remote_files(url: str) -> tuple[Any, str]:
    """Return the fsspec file system of a URL such as ``s3://bucket/site.laz``, and the path in it.

    Raises
    ------
    UsageError
        A package that the protocol needs is not installed, or there is no such protocol.
    """
    try:
        from fsspec.core import url_to_fs  # type: ignore[import-untyped, unused-ignore]
    except ImportError as error:
        raise UsageError(f"{url} is a URL, which needs: {_INSTALL}") from error
    try:
        files, name = url_to_fs(url)
    except ImportError as error:
        kind = url.split("://", 1)[0]
        raise UsageError(f"{kind}:// needs more ({error}). Install it: {_INSTALL}") from error
    except ValueError as error:
        raise UsageError(
            f"{url} is not a URL that can be used ({error}). Supported are s3://, https://, gs:// and other protocols "
            "of fsspec"
        ) from error
    return files, name


def without_keys(text: str) -> str:
    """Return a text whose URLs have no user and no query: both may hold a key, as that of a signed link."""
    return _URL.sub(r"\1\2", text)


def recorded_place(place: Path | str) -> str:
    """Return an input as files that are handed on name it: a URL without keys, but still unlike one with others.

    ``https://host/site.laz?key=abc`` becomes ``https://host/site.laz?left-out=1f0e...``, with a digest of the whole.
    """
    text = str(place)
    plain = without_keys(text) if isinstance(place, str) and "://" in text else text
    if plain == text:
        return text
    digest = hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()
    return f"{plain}?left-out={digest[:16]}"
