"""Byte ranges from web servers: no answer is longer than what was asked for, and none is waited for without end.

fsspec reads the body of an answer whole before it looks at it, and waits five minutes for one. So it gives the session
here (addresses, proxies, passwords), and the ranges are read from it.
"""

import re
import shlex
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError

__all__ = ["STALL_S", "StalledServerError", "is_web", "read_web", "web_info"]

STALL_S = 60.0
"""So long a server may send nothing, seconds."""
_WHOLE, _RANGE, _BEHIND_THE_END = 200, 206, 416


class StalledServerError(BadInputError):
    """A server sent nothing for ``STALL_S``."""


def is_web(url: str) -> bool:
    """Whether a URL is that of a web server."""
    return url.lower().startswith(("http://", "https://"))


def read_web(files: Any, url: str, start: int, data: NDArray[np.uint8]) -> tuple[int, Mapping[str, Any]]:
    """Fill an array with the bytes of a URL from ``start`` on.

    Parameters
    ----------
    files : fsspec.implementations.http.HTTPFileSystem
    url : str
    start : int
    data : uint8 (n,)

    Returns
    -------
    int
        How many bytes there were; fewer than n where the file ends.
    mapping
        As from `web_info`, of this answer.

    Raises
    ------
    BadInputError
        The server does not support range requests, returns other bytes, or (`StalledServerError`) none.
    """
    got: int
    got, info = _asked(files, url, start, data)
    return got, info


def web_info(files: Any, url: str) -> Mapping[str, Any]:
    """Ask for a single byte, and give what the server says beside it.

    Returns
    -------
    mapping
        Its headers, their names in small letters, and ``size``: bytes of the file, None where it does not say.
    """
    info: Mapping[str, Any]
    _, info = _asked(files, url, 0, None)
    return info


def _asked(files: Any, url: str, start: int, data: NDArray[np.uint8] | None) -> Any:
    from fsspec.asyn import sync

    try:
        return sync(files.loop, _ask, files, url, start, data)
    except TimeoutError as error:
        raise StalledServerError(
            f"the server of {url} sent nothing for {STALL_S:g} s. Try again later, or download the file first"
        ) from error


async def _ask(files: Any, url: str, start: int, data: NDArray[np.uint8] | None) -> tuple[int, Mapping[str, Any]]:
    from aiohttp import ClientTimeout

    size = 1 if data is None else data.size
    session = await files.set_session()
    wanted = {"Range": f"bytes={start}-{start + size - 1}", "Accept-Encoding": "identity"}
    options = files.kwargs | {"headers": files.kwargs.get("headers", {}) | wanted}
    patience = ClientTimeout(total=None, connect=STALL_S, sock_connect=STALL_S, sock_read=STALL_S)
    async with session.get(files.encode_url(url), timeout=patience, **options) as answer:
        if answer.status != _BEHIND_THE_END:
            answer.raise_for_status()
        first, total = _place(answer)
        info = {name.lower(): value for name, value in answer.headers.items()} | {"size": total}
        if data is None or answer.status == _BEHIND_THE_END:
            return 0, info
        if answer.status != _RANGE and not (start == 0 and total is not None and total <= size):
            raise BadInputError(
                f"the server of {url} does not support range requests. Download the file first, such as "
                f"with: curl -O {shlex.quote(url)}"
            )
        if first != start:
            raise BadInputError(f"the server of {url} returned byte {first:,} instead of byte {start:,}")
        got = 0
        async for part in answer.content.iter_any():
            if got + len(part) > size:
                raise BadInputError(f"the server of {url} returned more bytes than requested")
            data[got : got + len(part)] = np.frombuffer(part, np.uint8)
            got += len(part)
    return got, info


def _place(answer: Any) -> tuple[int, int | None]:
    """First byte of an answer, and bytes of the file as a whole; None where the server does not say."""
    if answer.status == _WHOLE:
        return 0, answer.content_length
    said = re.match(r"bytes (?:(\d+)-\d+|\*)/(\d+)", answer.headers.get("Content-Range", ""))
    return (int(said[1] or 0), int(said[2])) if said else (0, None)
