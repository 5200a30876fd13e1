"""Keeps Python's own housekeeping out of the live loop.

*Garbage.* A full collection walks every object that JAX, MuJoCo and SciPy made on import,
390,000 of them, and was measured to take 0.2 s: eight frames. So what exists after the
warm-up is frozen, automatic collection is off, and what the loop itself leaves behind is
collected between frames, where it is little.

*The interpreter lock.* A thread that computes in Python gives the lock up only when asked
for 5 ms by default. The device's thread needs it to stamp arriving bytes, the loop to take
them: half a millisecond keeps either from waiting for the other.
"""

import contextlib
import gc
import sys
import time
from collections.abc import Callable, Iterator

_SWITCH_INTERVAL = 5e-4
_TIDY_EVERY = 1.0


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """No automatic garbage collection and a quick interpreter lock, until the end.

    Enter after everything is imported, built and compiled.
    """
    was_enabled, interval = gc.isenabled(), sys.getswitchinterval()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if was_enabled:
            gc.enable()


class IdleWork:
    """What is done between frames: young garbage once a second, then the caller's chores.

    One chore a call, so that no gap between two frames has to hold them all.

    Args:
        chores: each with how often it is wanted [s].
        now: the clock [s].
    """

    def __init__(
        self,
        *chores: tuple[float, Callable[[], None]],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._chores = ((_TIDY_EVERY, _collect_young), *chores)
        self._due = [0.0] * len(self._chores)
        self._now = now

    def __call__(self) -> None:
        """Do the chore that has been due for longest, if any is."""
        now = self._now()
        first = min(range(len(self._due)), key=self._due.__getitem__)
        if self._due[first] <= now:
            every, chore = self._chores[first]
            chore()
            self._due[first] = now + every


def _collect_young() -> None:
    gc.collect(1)
