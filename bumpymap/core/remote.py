"""File systems of servers, by URL. fsspec is imported only if a URL is used."""

import re
from typing import Any

from bumpymap.core.errors import UsageError

__all__ = ["remote_files", "without_keys"]

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
