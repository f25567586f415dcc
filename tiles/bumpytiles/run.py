"""Apply a function to blocks on several threads; results come in order, and few blocks are in memory."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

__all__ = ["run_blocks"]

Block = TypeVar("Block")
Result = TypeVar("Result")


def run_blocks(function: Callable[[Block], Result], blocks: Iterable[Block], workers: int) -> Iterator[Result]:
    """Yield ``function(block)`` in the order of the blocks.

    At most ``2 * workers`` blocks are pending, so ``blocks`` may be a lazy iterator. The function should release the
    GIL (NumPy sorts and compiled kernels do).

    Parameters
    ----------
    function : callable
        Pure function of one block.
    blocks : iterable
        Consumed lazily.
    workers : int
        Number of threads, at least 1.
    """
    if workers < 1:
        raise ValueError(f"workers is {workers}; it must be at least 1")
    pending: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for block in blocks:
                pending.append(pool.submit(function, block))
                if len(pending) >= 2 * workers:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()
