"""Files read by several processes, their motions told in the order of the files."""

import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Final, TypeVar

from localreg.errors import MotionError

Item = TypeVar("Item")
Result = TypeVar("Result")

_AHEAD: Final = 4  # files a process that are under way: bounds what waits in memory


def in_order(work: Callable[[Item], Result], items: Iterable[Item], jobs: int) -> Iterator[Result]:
    """What became of every item, in order; with one job, in this process.

    Args:
        work: a function that other processes can import.
        items: what it is called with.
        jobs: number of processes.

    Raises:
        MotionError: a process died.
    """
    if jobs <= 1:
        yield from map(work, items)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, context, signal.signal, (signal.SIGINT, signal.SIG_IGN))
    waiting: deque[Future[Result]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) >= _AHEAD * jobs:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    except BrokenProcessPool as error:
        raise MotionError(
            "a process that read motions died, probably for want of memory; give fewer --jobs"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
