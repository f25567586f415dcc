"""Apply a function to blocks on several threads; results come in order, and few blocks are in memory."""

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

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
