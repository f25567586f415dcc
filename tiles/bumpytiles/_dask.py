"""Workers of dask.distributed, on this machine or on others: the one module that imports dask.

Workers are started here or found at a scheduler, and are given tasks. Only as many tasks are submitted as keep the
workers busy, and each result is yielded when it arrives, so nothing piles up on the scheduler or in the client. A task
whose worker dies is done again by another one; tasks must allow this.

A scheduler runs any code that it is sent. Workers that are started here use TLS with a temporary certificate of their
own, so no other user of the machine can connect.
"""
# mypy: allow-untyped-calls
# (distributed claims to be typed, but half of its functions are not)

import logging
import os
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from itertools import islice
from multiprocessing import forkserver, resource_tracker, set_forkserver_preload
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory, gettempdir
from threading import Thread
from typing import Any, NamedTuple

import dask
from distributed import Client, Future, KilledWorker, LocalCluster, Security, get_worker, utils as distributed_utils

from bumpytiles.processes import blocked_signals, safe_path

__all__ = ["ClusterError", "TlsFiles", "Workers", "local_workers", "threads_here", "workers_at"]

_TASKS_PER_WORKER = 2
"""Tasks submitted per worker: one that runs, and one that is ready when it ends."""
_CHECK_S = 10.0
"""Interval at which the number of workers is checked, s."""
_CHECKS, _LOCAL_CHECKS = 30, 3
"""Give up after this many checks in a row without workers: at a scheduler, with workers started here."""


_STOP_S = 5.0
"""How long the process that forks workers may take to end, s: it waits for the last of them."""
_NO_PAGES: dict[str, Any] = {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}
"""Serve no web pages: they would be open to every user of the machine."""
_NO_STATISTICS: dict[str, Any] = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.scheduler.active-memory-manager.start": False,
}
"""Collect no statistics for pages that are not served."""
_OWN_MALLOC: dict[str, Any] = {
    "distributed.nanny.pre-spawn-environ": {"OMP_NUM_THREADS": 1, "MKL_NUM_THREADS": 1, "OPENBLAS_NUM_THREADS": 1}
}
"""Without the MALLOC_TRIM_THRESHOLD_ of distributed: with it, the memory of every freed array goes back to the system,
and the next array is allocated page by page."""


class TlsFiles(NamedTuple):
    """PEM files with which client and scheduler authenticate each other."""

    ca: str
    """Certificate of the authority that signed the certificates of scheduler, workers and client."""
    cert: str
    """Certificate of this client."""
    key: str
    """Key of the client's certificate."""


class ClusterError(Exception):
    """No workers were found, or they were lost."""


class Workers:
    """The workers of a cluster.

    Parameters
    ----------
    client : distributed.Client
    checks : int
        Give up after this many checks in a row without workers.
    """

    def __init__(self, client: Client, checks: int = _CHECKS) -> None:
        self.client, self._checks = client, checks

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
        while without < self._checks:
            with suppress(Empty):
                return finished.get(timeout=_CHECK_S)
            without = 0 if self.count() else without + 1
        raise ClusterError(f"all workers were lost, and none came within {_CHECK_S * self._checks:.0f} s")


@contextmanager
def local_workers(number: int, environment: Mapping[str, str], modules: Sequence[str] = ()) -> Iterator[Workers]:
    """Start worker processes on this machine, each of which does one task at a time; stop them at the end.

    Parameters
    ----------
    number : int
    environment : mapping of str to str
        Environment variables of the workers, beside those of this process.
    modules : sequence of str
        Names of modules that tasks need. On Linux they are imported once for all workers (unless the path of the
        folder for temporary files is very long).

    Raises
    ------
    ImportError
        ``cryptography``, which makes their certificate, is not installed.
    """
    _silence_dask()
    security = Security.temporary()  # its key stays in memory; workers receive it through a pipe
    with ExitStack() as running:
        running.enter_context(safe_path())
        resource_tracker.ensure_running()  # else it starts with the first worker, and unblocks the signals
        with blocked_signals():
            folder = running.enter_context(TemporaryDirectory(prefix="bumpytiles-workers-", ignore_cleanup_errors=True))
            running.enter_context(
                dask.config.set({"temporary-directory": folder, **_NO_PAGES, **_NO_STATISTICS, **_OWN_MALLOC})
            )
            if sys.platform == "linux" and _has_room_for_socket():
                running.enter_context(_forked_workers(modules))
            cluster = running.enter_context(
                LocalCluster(
                    n_workers=number,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    security=security,
                    # The HTTP server starts all the same, without pages: on a free port, as the usual one may be taken.
                    dashboard_address=None,
                    scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                    memory_limit=0,  # tasks limit their memory themselves
                    silence_logs=logging.CRITICAL,
                    local_directory=folder,
                    env=dict(environment),
                )
            )
            workers = Workers(
                running.enter_context(Client(cluster, security=security, set_as_default=False)), _LOCAL_CHECKS
            )
        try:
            yield workers
        finally:
            with blocked_signals():
                running.close()


def _has_room_for_socket() -> bool:
    """Return whether the address of the socket through which workers are forked fits: the system allows 107 bytes."""
    return len(os.fsencode(gettempdir())) + len("/pymp-12345678/listener-12345678") <= 107


@contextmanager
def _forked_workers(modules: Sequence[str]) -> Iterator[None]:
    """Let workers be forks of one process that has imported ``modules``; stop it at the end, after its workers."""
    server: Any = forkserver._forkserver  # noqa: SLF001 (see below)
    is_ours = server._forkserver_pid is None  # noqa: SLF001
    with dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}):
        distributed_utils.get_mp_context()  # it sets modules of its own
        set_forkserver_preload(["distributed", "distributed.nanny", *modules])
        try:
            yield
        finally:
            if is_ours:  # otherwise it would keep its memory as long as this process runs
                stopping = Thread(target=server._stop, daemon=True)  # noqa: SLF001 (there is no public function)
                stopping.start()
                stopping.join(_STOP_S)


@contextmanager
def workers_at(address: str, patience_s: float, tls: TlsFiles | None = None) -> Iterator[Workers]:
    """Connect to the workers of a scheduler.

    Parameters
    ----------
    address : str
    patience_s : float
    tls : TlsFiles, optional
        For an address ``tls://``.

    Raises
    ------
    ClusterError
        No scheduler answers within ``patience_s`` seconds, or it has no workers by then.
    """
    _silence_dask()
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
    """Return the number of threads that the calling worker was started with."""
    return int(get_worker().state.nthreads)


def _silence_dask() -> None:
    """Silence dask's log: errors are raised, and workers that are stopped would log errors."""
    for name in ("distributed", "distributed.client"):  # the client's has a level of its own
        logging.getLogger(name).setLevel(logging.CRITICAL)


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
