"""Work on several threads, and in processes of its own.

Python puts the current folder, where strangers' files may lie, on the path of ``python -c`` and so of what
`multiprocessing` starts. No process that is started here has it there, nor has any that those start.
"""

import os
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

Block = TypeVar("Block")
Result = TypeVar("Result")


def run_blocks(
    function: Callable[[Block], Result], blocks: Iterable[Block], workers: int, most: int | None = None
) -> Generator[Result, None, None]:
    """Yield ``function(block)`` in the order of the blocks.

    Few blocks are pending, so ``blocks`` may be a lazy iterator. The function should release the GIL (NumPy sorts and
    compiled loops do).

    Parameters
    ----------
    function : callable
        Pure function of one block.
    blocks : iterable
        Consumed lazily.
    workers : int
        Number of threads, at least 1.
    most : int, optional
        Blocks that are pending at most; ``2 * workers`` without.
    """
    if workers < 1:
        raise ValueError(f"workers is {workers}; it must be at least 1")
    pending: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for block in blocks:
                pending.append(pool.submit(function, block))
                del block  # it may hold much, and be done long before the next
                if len(pending) >= (most or 2 * workers):
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()


def grouped_blocks(blocks: Iterable[Block], size: Callable[[Block], int], most: int) -> Iterator[list[Block]]:
    """Yield blocks in order, small ones in groups: the fixed time of a block then counts once for many.

    Parameters
    ----------
    blocks : iterable
        Consumed lazily.
    size : callable
        Size of a block, such as its number of points.
    most : int
        Largest size of a group; a larger block is alone.
    """
    group: list[Block] = []
    held = 0
    for block in blocks:
        own = size(block)
        if group and held + own > most:
            yield group
            group, held = [], 0
        group.append(block)
        held += own
    if group:
        yield group


def start_python(
    arguments: Sequence[str], *, isolated: bool = False, environment: Mapping[str, str] | None = None, **settings: Any
) -> "subprocess.Popen[bytes]":
    """Start this Python without input; its path is the same but for the current folder.

    Parameters
    ----------
    arguments : sequence of str
    isolated : bool
        Leave out site-packages and Python's environment variables too.
    environment : mapping, optional
        Environment variables to add to those of this process.
    **settings
        Those of `subprocess.Popen`.
    """
    flags = ("-I", "-S") if isolated else ("-P",)
    return subprocess.Popen(  # noqa: S603 (this Python)
        [sys.executable, *flags, *arguments],
        stdin=subprocess.DEVNULL,
        env={**os.environ, "PYTHONSAFEPATH": "1", **(environment or {})},
        **settings,
    )


@contextmanager
def blocked_signals() -> Iterator[None]:
    """Block SIGINT and SIGTERM during the body; threads and processes that it starts keep them blocked.

    Both signals reach every process of a terminal or a batch job, but only the main process handles them, and stops
    its workers. A process that receives one while it imports, starts or stops would end with a traceback.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
