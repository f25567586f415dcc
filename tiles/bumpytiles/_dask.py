"""Workers of dask.distributed, on this machine or on others: the one module that imports dask.

Workers are started or found, asked something one by one, and given tasks. No more tasks are handed out than keep the
workers busy, and each result is given away when it comes, so nothing piles up on the scheduler or in the client. A
task whose worker dies is done again by another one; what it does must bear that.

A scheduler runs whatever code it is sent. Workers that are started here talk TLS among each other, with a certificate
of their own that lives as long as they do: no other user of the machine gets in.
"""
# mypy: allow-untyped-calls
# (distributed says that it is typed, and leaves half of its functions out)

import logging
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from itertools import islice
from multiprocessing import resource_tracker
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import dask
from distributed import Client, Future, KilledWorker, LocalCluster, Security, get_worker

from bumpytiles.signals import blocked_signals

__all__ = ["ClusterError", "TlsFiles", "Workers", "local_workers", "threads_here", "workers_at"]

_AHEAD = 2
"""Tasks handed out for each worker: one is done, one is at hand when it is finished."""
_LOOK_S = 10.0
"""So often it is looked whether workers are left, s."""
_LOOKS, _LOCAL_LOOKS = 30, 3
"""So many times in a row without workers are the end: of a cluster, of workers that were started here."""


_NO_PAGES: dict[str, Any] = {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}
"""Nothing is shown to browsers: those pages are open to every user of the machine."""


class TlsFiles(NamedTuple):
    """PEM files with which a client shows a scheduler who it is, and knows the scheduler."""

    ca: str
    """Certificate of the authority that signed the certificates of scheduler, workers and client."""
    cert: str
    """Certificate of this client."""
    key: str
    """Its key."""


class ClusterError(Exception):
    """There are no workers, or they were lost."""


class Workers:
    """What does tasks.

    Parameters
    ----------
    client : distributed.Client
    looks : int
        So many times in a row without workers are the end.
    """

    def __init__(self, client: Client, looks: int = _LOOKS) -> None:
        self.client = client
        self._looks = looks

    def count(self) -> int:
        """Workers that are there now."""
        with _losses():
            return len(self.client.nthreads())

    def each(self, function: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        """Ask every worker; gives the answer, or the exception, by address. What a worker does meanwhile goes on.

        Workers that are lost meanwhile do not count.

        Raises
        ------
        ClusterError
            No worker is left.
        """
        with _losses():
            answers: dict[str, Any] = self.client.run(function, *arguments, on_error="return")
        # What is asked here raises no OSError of its own: it is the connection that broke.
        left = {address: answer for address, answer in answers.items() if not isinstance(answer, OSError)}
        if not left:
            were = f"all {len(answers)} workers were lost" if len(answers) > 1 else "the last worker was lost"
            raise ClusterError(f"{were}; they may have been killed")
        return left

    def run(
        self, function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]]
    ) -> Generator[tuple[int, Any], None, None]:
        """Do ``function(*task)`` for each task; yield the number of the task and its result, in any order.

        Close the generator to give up: tasks that were not begun are taken back, others run to their end unheard.

        Parameters
        ----------
        function : callable
            Picklable; done once or, where a worker dies or is cut off, several times, even at the same time.
        tasks : iterable of tuple
            Arguments; drawn as they are needed.

        Raises
        ------
        ClusterError
            Workers died again and again over a task, or none is left, or the scheduler is gone.
        Exception
            What a task raised.
        """
        waiting = enumerate(tasks)
        numbers: dict[Future[Any], int] = {}
        finished: SimpleQueue[Future[Any]] = SimpleQueue()
        try:
            while True:
                room = max(_AHEAD * self.count(), 1) - len(numbers)
                for number, task in islice(waiting, max(room, 0)):
                    future = self.client.submit(function, *task, pure=False)
                    numbers[future] = number
                    future.add_done_callback(finished.put)
                if not numbers:
                    return
                future = self._next(finished)
                yield numbers.pop(future), _result(future)
        finally:
            with suppress(Exception):  # there may be no scheduler any more
                self.client.cancel(list(numbers), force=True)

    def _next(self, finished: "SimpleQueue[Future[Any]]") -> Future[Any]:
        """Wait for a task; look meanwhile whether there are workers at all."""
        without = 0
        while without < self._looks:
            with suppress(Empty):
                return finished.get(timeout=_LOOK_S)
            without = 0 if self.count() else without + 1
        raise ClusterError(f"all workers were lost, and none came within {_LOOK_S * self._looks:.0f} s")


@contextmanager
def local_workers(number: int, environment: Mapping[str, str]) -> Iterator[Workers]:
    """Start worker processes on this machine, each of which does one task at a time; stop them in the end.

    Raises
    ------
    ImportError
        ``cryptography``, which makes their certificate, is not installed.
    """
    _quiet()
    security = Security.temporary()  # its key stays in memory; a worker is handed it through a pipe
    with ExitStack() as running:
        resource_tracker.ensure_running()  # or it starts with the first worker, and unblocks the signals
        with blocked_signals():
            folder = running.enter_context(TemporaryDirectory(prefix="bumpytiles-workers-", ignore_cleanup_errors=True))
            running.enter_context(dask.config.set({"temporary-directory": folder, **_NO_PAGES}))
            cluster = running.enter_context(
                LocalCluster(
                    n_workers=number,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    security=security,
                    # It listens for browsers all the same, without pages: on any free port, the usual may be taken.
                    dashboard_address=None,
                    scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                    memory_limit=0,  # tasks keep to their own budget
                    silence_logs=logging.CRITICAL,
                    local_directory=folder,
                    env=dict(environment),
                )
            )
            workers = Workers(
                running.enter_context(Client(cluster, security=security, set_as_default=False)), _LOCAL_LOOKS
            )
        try:
            yield workers
        finally:
            with blocked_signals():
                running.close()


@contextmanager
def workers_at(address: str, patience_s: float, tls: TlsFiles | None = None) -> Iterator[Workers]:
    """Use the workers of a scheduler.

    Parameters
    ----------
    address : str
    patience_s : float
    tls : TlsFiles, optional
        For an address ``tls://``.

    Raises
    ------
    ClusterError
        No scheduler answers there within ``patience_s`` seconds, or it has no workers for as long.
    """
    _quiet()
    try:
        client = Client(address, security=_security(tls), timeout=patience_s, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ClusterError(f"no scheduler answers at {address} ({error})") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=patience_s)
        except TimeoutError as error:
            raise ClusterError(f"the scheduler at {address} has no workers") from error
        yield Workers(client)


def _security(tls: TlsFiles | None) -> Security | None:
    if tls is None:
        return None
    return Security(tls_ca_file=tls.ca, tls_client_cert=tls.cert, tls_client_key=tls.key, require_encryption=True)


def threads_here() -> int:
    """Threads that the worker was started with in which this is called."""
    return int(get_worker().state.nthreads)


def _quiet() -> None:
    """Keep dask's own log lines off the terminal: what goes wrong is raised, and workers that are stopped complain."""
    logging.getLogger("distributed").setLevel(logging.CRITICAL)


def _result(future: Future[Any]) -> Any:
    with _losses():
        error = future.exception()
        if error is None:
            return future.result()
    if isinstance(error, KilledWorker):
        raise ClusterError(f"{error.allowed_failures + 1} workers died one after the other over one task") from error
    raise error


@contextmanager
def _losses() -> Iterator[None]:
    """Tell what the client raises when it loses the scheduler."""
    try:
        yield
    except (OSError, CancelledError) as error:
        raise ClusterError("the connection to the scheduler is lost") from error
