"""Workers of dask.distributed: found at a scheduler, or started on this machine."""

import logging
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bumpymap.core import UsageError, error_chain
from bumpymap.survey.engine.tls import plain_note, read_tls_settings

if TYPE_CHECKING:
    from bumpytiles import Workers

__all__ = ["PATIENCE_S", "WorkerPool", "connect", "worker_losses"]

_log = logging.getLogger(__name__)

PATIENCE_S = 30.0
"""So long a scheduler may take to answer, and tasks of a run that was given up may take to notice."""


@dataclass(frozen=True, slots=True)
class WorkerPool:
    """Workers, and what each of them may use."""

    workers: "Workers"
    threads: int | None
    """None: as many as each worker was started with."""


@contextmanager
def connect(
    scheduler: str | None, workers: int | None, threads: int, tls_config: Path | None = None
) -> Iterator[WorkerPool | None]:
    """Find the workers of a scheduler, or start some here that share out the threads; None where neither was wanted.

    Raises
    ------
    UsageError
        dask.distributed is not installed, or the scheduler does not answer or has no workers; certificates that cannot
        be used.
    """
    with ExitStack() as stack:
        try:
            pool = None
            if scheduler is not None:
                pool = _found(scheduler, tls_config, stack)
            elif workers is not None:
                pool = _started(workers, threads, stack)
        except ImportError as error:
            raise UsageError(
                f"`scheduler` and `workers` need dask.distributed and cryptography ({error}). Install them: "
                "pip install 'bumpymap[dask]'"
            ) from error
        yield pool


def _found(scheduler: str, tls_config: Path | None, stack: ExitStack) -> WorkerPool:
    from bumpytiles import TlsFiles, workers_at

    start = "Start it: dask scheduler on one machine, dask worker ADDRESS on others; then pass the scheduler's address"
    tls, remedy = None, f"{start}, such as tcp://10.0.0.1:8786, or tls:// where it uses TLS"
    if tls_config is not None:
        settings = read_tls_settings(tls_config)
        tls = TlsFiles(str(settings.ca), str(settings.cert), str(settings.key))
        remedy = f"Was it started with TLS and a certificate that the authority in {settings.ca} signed? {start}"
    elif (note := plain_note(scheduler)) is not None:
        _log.warning(note)
    stack.enter_context(worker_losses(remedy))
    return WorkerPool(stack.enter_context(workers_at(scheduler, PATIENCE_S, tls)), None)


def _started(workers: int, threads: int, stack: ExitStack) -> WorkerPool:
    from bumpytiles import local_workers

    each = max(1, threads // workers)
    # The LAZ decoder takes every core unless it is told otherwise.
    started = _with_reasons(local_workers(workers, {"RAYON_NUM_THREADS": str(each)}))
    return WorkerPool(stack.enter_context(started), each)


@contextmanager
def _with_reasons(workers: AbstractContextManager["Workers"]) -> Iterator["Workers"]:
    """Start workers here, and stop them in the end; say what to do where they do not start."""
    with ExitStack() as stack:
        try:
            found = stack.enter_context(workers)
        except (RuntimeError, OSError) as error:
            if any(isinstance(cause, OSError) and cause.errno is not None for cause in error_chain(error)):
                raise  # the system says why
            raise UsageError(
                f"the workers did not start ({error}); they may have been killed. Try again, or fewer `workers`"
            ) from error
        with worker_losses("Try fewer `workers`"):
            yield found


@contextmanager
def worker_losses(remedy: str) -> Iterator[None]:
    """Say what to do where workers cannot be had or were lost."""
    from bumpytiles import ClusterError

    try:
        yield
    except ClusterError as error:
        raise UsageError(f"{error}. {remedy}") from error
