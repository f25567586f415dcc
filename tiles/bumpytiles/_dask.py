"""Workers of a dask.distributed scheduler: the one module that imports dask.

Only as many tasks are submitted as keep the workers busy, and each result is yielded when it arrives, so nothing piles
up on the scheduler or in the client. A task whose worker dies is done again by another one; tasks must allow this.
"""
# mypy: allow-untyped-calls
# (distributed claims to be typed, but half of its functions are not)

import logging
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from itertools import islice
from queue import Empty, SimpleQueue
from typing import Any

from distributed import Client, Future, KilledWorker, get_worker

_TASKS_PER_WORKER = 2
"""Tasks submitted per worker: one that runs, and one that is ready when it ends."""
_CHECK_S, _CHECKS = 10.0, 30
"""Interval at which the number of workers is checked, s; give up after this many checks in a row without workers."""


class ClusterError(Exception):
    """No workers were found, or they were lost."""


class Workers:
    """The workers of a cluster.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client: Client) -> None:
        self.client = client

    def count(self) -> int:
        """Return the number of workers that are connected."""
        with _connection_errors():
            return len(self.client.nthreads())

    def each(self, function: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        """Call a function on every worker, beside its tasks; return the result or the exception by address.

        Workers that are lost during the call are left out.

        Raises
        ------
        ClusterError
            No worker is left.
        """
        with _connection_errors():
            answers: dict[str, Any] = self.client.run(function, *arguments, on_error="return")
        # The functions called here raise no OSError themselves, so it is the connection that broke.
        left = {address: answer for address, answer in answers.items() if not isinstance(answer, OSError)}
        if not left:
            were = f"all {len(answers)} workers were lost" if len(answers) > 1 else "the last worker was lost"
            raise ClusterError(f"{were}; they may have been killed")
        return left

    def run(
        self, function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]]
    ) -> Generator[tuple[int, Any], None, None]:
        """Do ``function(*task)`` for each task; yield the number of the task and its result, in any order.

        Closing the generator cancels tasks that have not started; the results of running ones are discarded.

        Parameters
        ----------
        function : callable
            Picklable. Called once per task or, if a worker dies or is cut off, several times, even concurrently.
        tasks : iterable of tuple
            Arguments; consumed lazily.

        Raises
        ------
        ClusterError
            Several workers died while doing one task, no worker is left, or the scheduler is lost.
        Exception
            Any exception of a task.
        """
        waiting = enumerate(tasks)
        numbers: dict[Future[Any], int] = {}
        finished: SimpleQueue[Future[Any]] = SimpleQueue()
        try:
            while True:
                room = max(_TASKS_PER_WORKER * self.count(), 1) - len(numbers)
                for number, task in islice(waiting, max(room, 0)):
                    future = self.client.submit(function, *task, pure=False)
                    numbers[future] = number
                    future.add_done_callback(finished.put)
                if not numbers:
                    return
                future = self._next(finished)
                yield numbers.pop(future), _result(future)
        finally:
            with suppress(Exception):  # the scheduler may be lost
                self.client.cancel(list(numbers), force=True)

    def _next(self, finished: "SimpleQueue[Future[Any]]") -> Future[Any]:
        """Wait for a finished task, and check meanwhile that there are workers."""
        without = 0
        while without < _CHECKS:
            with suppress(Empty):
                return finished.get(timeout=_CHECK_S)
            without = 0 if self.count() else without + 1
        raise ClusterError(f"all workers were lost, and none came within {_CHECK_S * _CHECKS:.0f} s")


class _Client(Client):
    """A client that ends its thread if it cannot connect.

    distributed leaves that to the garbage collector. If it comes while the next client starts its own thread, it waits
    for ever for a lock that this one holds.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        try:
            super().__init__(*arguments, **options)
        except BaseException:
            with suppress(Exception):  # it may lack anything yet
                try:
                    self.close()
                finally:  # not done by `close` if the client closed itself
                    self._loop_runner.stop()
            raise


@contextmanager
def workers_at(address: str, patience_s: float) -> Iterator[Workers]:
    """Connect to the workers of a scheduler.

    Parameters
    ----------
    address : str
        With TLS (``tls://``) dask reads the certificates from its own configuration (``distributed.comm.tls``).
    patience_s : float

    Raises
    ------
    ClusterError
        No scheduler answers within ``patience_s`` seconds, or it has no workers by then.
    """
    for name in ("distributed", "distributed.client"):  # errors are raised; the client's log has a level of its own
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = _Client(address, timeout=patience_s, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ClusterError(f"no scheduler answers at {address} ({error})") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=patience_s)
        except TimeoutError as error:
            raise ClusterError(f"the scheduler at {address} has no workers") from error
        yield Workers(client)


def threads_here() -> int:
    """Return the number of threads that the calling worker was started with."""
    return int(get_worker().state.nthreads)


def _result(future: Future[Any]) -> Any:
    with _connection_errors():
        error = future.exception()
        if error is None:
            return future.result()
    if isinstance(error, KilledWorker):
        raise ClusterError(f"{error.allowed_failures + 1} workers died one after the other over one task") from error
    raise error


@contextmanager
def _connection_errors() -> Iterator[None]:
    """Turn the exceptions of a client that lost the scheduler into ClusterError."""
    try:
        yield
    except (OSError, CancelledError) as error:
        raise ClusterError("the connection to the scheduler is lost") from error
