"""Work on items in threads, with the results in order and only a few of them in memory."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

__all__ = ["in_threads"]

Item = TypeVar("Item")
Result = TypeVar("Result")
_AHEAD = 2
"""Items under way or waiting to be taken, for each thread."""


@contextmanager
def in_threads(
    work: Callable[[Item], Result], items: Iterable[Item], threads: int
) -> Iterator[Iterator[Callable[[], Result]]]:
    """Work on items in threads; yield, for each item in order, a function that returns the result.

    That function waits for the result, and raises what ``work`` raised. At the end of the ``with`` block, items that
    nobody has begun are dropped, and those under way are finished. With one thread, ``work`` runs in this thread, when
    its result is asked for.

    Parameters
    ----------
    work : callable
        Called by several threads at a time.
    items : iterable
    threads : int
    """
    if threads == 1:
        yield (partial(work, item) for item in items)
        return
    with ThreadPoolExecutor(threads) as pool:
        try:
            yield (future.result for future in _ahead(pool, work, items, _AHEAD * threads))
        finally:
            pool.shutdown(cancel_futures=True)


def _ahead(
    pool: ThreadPoolExecutor, work: Callable[[Item], Result], items: Iterable[Item], most: int
) -> Iterator[Future[Result]]:
    waiting: deque[Future[Result]] = deque()
    for item in items:
        waiting.append(pool.submit(work, item))
        if len(waiting) >= most:
            yield waiting.popleft()
    yield from waiting
