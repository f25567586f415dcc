"""Workers of dask.distributed: found at a scheduler, or started on this machine."""

import logging
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bumpymap.core import UsageError, error_chain
from bumpymap.survey.engine.tls import read_tls_settings, warning_without_tls

if TYPE_CHECKING:
    from bumpytiles import Workers

__all__ = ["TIMEOUT_S", "WorkerPool", "connect", "worker_errors"]

_log = logging.getLogger(__name__)

_MODULES = ("bumpymap.survey.engine.tasks", "bumpymap.survey.tile_rating", "onnxruntime")
"""Modules that workers need for their tasks."""

TIMEOUT_S = 30.0
"""How long a scheduler may take to answer, and tasks of a cancelled run may take to end, s."""


@dataclass(frozen=True, slots=True)
class WorkerPool:
    """Workers, and the threads that each may use."""

    workers: "Workers"
    threads: int | None
    """None: the number that each worker was started with."""
    is_local: bool = False
    """Whether this process started the workers: they have the same software."""


@contextmanager
def connect(
    scheduler: str | None, workers: int | None, threads: int, tls_config: Path | None = None
) -> Iterator[WorkerPool | None]:
    """Connect to the workers of a scheduler, or start local ones that share ``threads``; yield None if neither is set.

    Raises
    ------
    UsageError
        dask.distributed is not installed, the scheduler does not answer or has no workers, or the certificates cannot
        be used.
    """
    with ExitStack() as stack:
        try:
            pool = None
            if scheduler is not None:
                pool = _find_workers(scheduler, tls_config, stack)
            elif workers is not None:
                pool = _start_workers(workers, threads, stack)
        except ImportError as error:
            raise UsageError(
                f"`scheduler` and `workers` need dask.distributed and cryptography ({error}). Install them: "
                "pip install 'bumpymap[dask]'"
            ) from error
        yield pool


def _find_workers(scheduler: str, tls_config: Path | None, stack: ExitStack) -> WorkerPool:
    from bumpytiles import TlsFiles, workers_at

    start = "Start it: dask scheduler on one machine, dask worker ADDRESS on others; then pass the scheduler's address"
    tls, remedy = None, f"{start}, such as tcp://10.0.0.1:8786, or tls:// if it uses TLS"
    if tls_config is not None:
        settings = read_tls_settings(tls_config)
        tls = TlsFiles(str(settings.ca), str(settings.cert), str(settings.key))
        remedy = f"Was it started with TLS and a certificate that the authority in {settings.ca} signed? {start}"
    elif (note := warning_without_tls(scheduler)) is not None:
        _log.warning(note)
    stack.enter_context(worker_errors(remedy))
    return WorkerPool(stack.enter_context(workers_at(scheduler, TIMEOUT_S, tls)), None)


def _start_workers(workers: int, threads: int, stack: ExitStack) -> WorkerPool:
    from bumpytiles import compile_packages, local_workers

    compile_packages("bumpymap", "bumpytiles", at_once=False)  # here it is told, and not done by each worker
    each = max(1, threads // workers)
    # The LAZ decoder uses every core by default.
    started = _explain_failed_start(local_workers(workers, {"RAYON_NUM_THREADS": str(each)}, _MODULES))
    return WorkerPool(stack.enter_context(started), each, is_local=True)


@contextmanager
def _explain_failed_start(workers: AbstractContextManager["Workers"]) -> Iterator["Workers"]:
    """Start local workers, stop them at the end; raise UsageError with advice if they do not start."""
    with ExitStack() as stack:
        try:
            found = stack.enter_context(workers)
        except (RuntimeError, OSError) as error:
            if any(isinstance(cause, OSError) and cause.errno is not None for cause in error_chain(error)):
                raise  # the message of the system says why
            raise UsageError(
                f"the workers did not start ({error}); they may have been killed. Try again, or fewer `workers`"
            ) from error
        with worker_errors("Try fewer `workers`"):
            yield found


@contextmanager
def worker_errors(remedy: str) -> Iterator[None]:
    """Turn the loss of workers into a UsageError that says what to do."""
    from bumpytiles import ClusterError

    try:
        yield
    except ClusterError as error:
        raise UsageError(f"{error}. {remedy}") from error
