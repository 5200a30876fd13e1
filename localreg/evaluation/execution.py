"""Where trials are run: in this process or in several; `cluster` has the third place.

A `Run` outlives one evaluation, so that a series of them pays once for its processes and
for what they compile. The results do not depend on where trials are run.
"""

import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from localreg.database import PoseDatabase
from localreg.errors import LocalregError
from localreg.evaluation.protocol import Protocol, Trial
from localreg.evaluation.results import ClipResult
from localreg.evaluation.worker import Worker

Run = Callable[[Sequence[Trial], Protocol], Iterator[list[ClipResult]]]
"""The results of every trial, in the order in which they are done."""


@contextmanager
def processes(database: PoseDatabase, jobs: int = 1, folder: Path | None = None) -> Iterator[Run]:
    """Run trials in so many processes; with one job, in this one.

    Args:
        database: what the methods learn from.
        jobs: number of processes.
        folder: where the database is saved, if it is; the processes map it from there.
    """
    if jobs <= 1:
        worker = Worker(database)
        yield lambda trials, protocol: (worker.run(trial, protocol) for trial in trials)
        return
    with tempfile.TemporaryDirectory(prefix="localreg-") as temporary:
        if folder is None:
            folder = Path(temporary) / "database"
            database.save(folder)
        with _pool(jobs, folder) as pool:
            yield lambda trials, protocol: _results(
                [pool.submit(_run_in_process, trial, protocol) for trial in trials]
            )


def default_jobs() -> int:
    """One process for every core that this process may use."""
    return len(os.sched_getaffinity(0))


@contextmanager
def _pool(jobs: int, folder: Path) -> Iterator[ProcessPoolExecutor]:
    """Processes that are gone at the end, whatever happens meanwhile."""
    others = set(multiprocessing.active_children())
    # Forked processes would inherit XLA's threads without the threads.
    pool = ProcessPoolExecutor(
        jobs, multiprocessing.get_context("spawn"), _begin_process, (folder,)
    )
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise


def _results(futures: Iterable[Future[list[ClipResult]]]) -> Iterator[list[ClipResult]]:
    try:
        for future in as_completed(futures):
            yield future.result()
    except BrokenProcessPool as error:
        raise LocalregError(
            "a process of the evaluation died, probably for want of memory; give fewer --jobs"
        ) from error


_WORKERS: Final[list[Worker]] = []


def _begin_process(folder: Path) -> None:
    # Ctrl-C is the parent's to handle, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _WORKERS[:] = [Worker(PoseDatabase.load(folder, verify=False))]


def _run_in_process(trial: Trial, protocol: Protocol) -> list[ClipResult]:
    return _WORKERS[0].run(trial, protocol)
