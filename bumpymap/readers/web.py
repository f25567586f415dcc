"""Read byte ranges from web servers, with limits on the size of a response and on the time to wait for it.

fsspec reads the whole body of a response before it checks it, and waits five minutes for one. So only its session
(URLs, proxies, passwords) is used here, and the ranges are requested directly.
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
"""Seconds that a server may send nothing."""
_WHOLE, _RANGE, _PAST_THE_END = 200, 206, 416


class StalledServerError(BadInputError):
    """A server sent nothing for ``STALL_S`` seconds."""


def is_web(url: str) -> bool:
    """Return whether a URL is http or https."""
    return url.lower().startswith(("http://", "https://"))


def read_web(files: Any, url: str, start: int, data: NDArray[np.uint8]) -> tuple[int, Mapping[str, Any]]:
    """Read bytes of a URL from offset ``start`` into an array.

    Parameters
    ----------
    files : fsspec.implementations.http.HTTPFileSystem
    url : str
    start : int
    data : uint8 (n,)

    Returns
    -------
    int
        Number of bytes read; fewer than n at the end of the file.
    mapping
        Headers of the response, as from `web_info`.

    Raises
    ------
    BadInputError
        The server does not support range requests, sends other bytes, or (`StalledServerError`) sends none.
    """
    got: int
    got, info = _fetch(files, url, start, data)
    return got, info


def web_info(files: Any, url: str) -> Mapping[str, Any]:
    """Request a single byte, and return the headers of the response.

    Returns
    -------
    mapping
        Headers by name in lower case, and ``size``: bytes of the file, None if the server does not report it.
    """
    info: Mapping[str, Any]
    _, info = _fetch(files, url, 0, None)
    return info


def _fetch(files: Any, url: str, start: int, data: NDArray[np.uint8] | None) -> Any:
    from fsspec.asyn import sync

    try:
        return sync(files.loop, _request, files, url, start, data)
    except TimeoutError as error:
        raise StalledServerError(
            f"the server of {url} sent nothing for {STALL_S:g} s. Try again later, or download the file first"
        ) from error


async def _request(files: Any, url: str, start: int, data: NDArray[np.uint8] | None) -> tuple[int, Mapping[str, Any]]:
    from aiohttp import ClientTimeout

    size = 1 if data is None else data.size
    session = await files.set_session()
    wanted = {"Range": f"bytes={start}-{start + size - 1}", "Accept-Encoding": "identity"}
    options = files.kwargs | {"headers": files.kwargs.get("headers", {}) | wanted}
    timeout = ClientTimeout(total=None, connect=STALL_S, sock_connect=STALL_S, sock_read=STALL_S)
    async with session.get(files.encode_url(url), timeout=timeout, **options) as response:
        if response.status != _PAST_THE_END:
            response.raise_for_status()
        first, total = _range_of(response)
        info = {name.lower(): value for name, value in response.headers.items()} | {"size": total}
        if data is None or response.status == _PAST_THE_END:
            return 0, info
        if response.status != _RANGE and not (start == 0 and total is not None and total <= size):
            raise BadInputError(
                f"the server of {url} does not support range requests. Download the file first, such as "
                f"with: curl -O {shlex.quote(url)}"
            )
        if first != start:
            raise BadInputError(f"the server of {url} returned byte {first:,} instead of byte {start:,}")
        got = 0
        async for part in response.content.iter_any():
            if got + len(part) > size:
                raise BadInputError(f"the server of {url} returned more bytes than requested")
            data[got : got + len(part)] = np.frombuffer(part, np.uint8)
            got += len(part)
    return got, info


def _range_of(response: Any) -> tuple[int, int | None]:
    """Return the offset of the response's first byte, and the size of the file (None if not reported)."""
    if response.status == _WHOLE:
        return 0, response.content_length
    found = re.match(r"bytes (?:(\d+)-\d+|\*)/(\d+)", response.headers.get("Content-Range", ""))
    return (int(found[1] or 0), int(found[2])) if found else (0, None)
