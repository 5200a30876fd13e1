"""Trials on a Dask cluster (extra `cluster`): several machines, or workers that come and go.

Dask hands pickled Python objects from process to process, so everyone who can reach the
scheduler can run code on the workers: keep it on a network that you trust.
"""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

from localreg.database import PoseDatabase
from localreg.errors import LocalregError
from localreg.evaluation.execution import Run
from localreg.evaluation.protocol import Protocol, Trial
from localreg.evaluation.results import ClipResult
from localreg.evaluation.worker import Worker

_PATIENCE: Final = "20s"


@contextmanager
def cluster(database: PoseDatabase, address: str) -> Iterator[Run]:
    """Run trials on the workers of a Dask scheduler.

    Every worker is sent the database once. What a worker was doing when it died is done by
    another one; every trial gives its results exactly once.

    Args:
        database: what the methods learn from.
        address: the scheduler's, such as `tcp://10.0.0.1:8786`.

    Raises:
        LocalregError: Dask is not installed, nobody answers, there are no workers, or too
            many of them died.
    """
    try:
        from distributed import Client
        from distributed.scheduler import NoValidWorkerError
    except ImportError as error:
        raise LocalregError(
            'Dask is not installed; install it with: pip install "localreg-mocap[cluster]"'
        ) from error
    try:
        client: Any = Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise LocalregError(
            f"no Dask scheduler answers at {address}; start one with `dask scheduler` and give "
            "the address that it prints"
        ) from error
    with client:
        if not client.scheduler_info(n_workers=-1)["workers"]:
            raise LocalregError(
                f"the Dask scheduler at {address} has no workers; start some with "
                f"`dask worker {address} --nworkers auto --nthreads 1`"
            )
        try:
            (held,) = client.scatter([database], broadcast=True, hash=False)
        except (OSError, TimeoutError, NoValidWorkerError) as error:
            raise _unwell(address) from error
        yield lambda trials, protocol: _results(client, address, held, trials, protocol)


def _results(
    client: Any, address: str, held: Any, trials: Sequence[Trial], protocol: Protocol
) -> Iterator[list[ClipResult]]:
    from distributed import as_completed
    from distributed.client import FutureCancelledError
    from distributed.scheduler import KilledWorker

    # Not pure: trials that look alike must not share a result.
    futures = [client.submit(_run_on_worker, held, trial, protocol, pure=False) for trial in trials]
    try:
        for future in as_completed(futures, loop=client.loop):
            yield future.result()
            future.release()
    except (KilledWorker, FutureCancelledError, OSError) as error:
        raise _unwell(address) from error
    finally:
        client.cancel(futures)


def _unwell(address: str) -> LocalregError:
    return LocalregError(
        f"too many workers of the Dask scheduler at {address} died, perhaps for want of memory; "
        "look into their logs and start others"
    )


_LOCAL: Final = threading.local()


def _run_on_worker(database: PoseDatabase, trial: Trial, protocol: Protocol) -> list[ClipResult]:
    """A worker process may have several threads; each keeps estimators of its own."""
    if getattr(_LOCAL, "database", None) is not database:
        _LOCAL.database, _LOCAL.worker = database, Worker(database)
    return _LOCAL.worker.run(trial, protocol)
