"""A thread of its own for a sink that may have to wait: for a disk, or for slow peers."""

import threading
from collections import deque

from localreg.errors import LocalregError
from localreg.live.sinks.base import LivePose, Sink

_CLOSING = 10.0
"""How long closing waits for what is still to be written [s]."""


class Background(Sink):
    """Hands poses on in a thread, so that the live loop never waits.

    When the queue is full the oldest pose gives way and is counted: with a capacity of one
    the newest wins, as views want it; a file's queue holds many seconds and loses nothing
    unless the disk stands still for longer.

    A sink that fails is closed and gets no more poses; the next `publish` says so, once.

    Args:
        sink: who is handed the poses; only the thread calls it from now on.
        capacity: poses that may wait.
    """

    def __init__(self, sink: Sink, capacity: int) -> None:
        self.name = sink.name
        self._sink = sink
        self._capacity = capacity
        self._waiting: deque[LivePose] = deque()
        self._changed = threading.Condition()
        self._lost = 0
        self._failure: str | None = None
        self._is_failure_told = False
        self._is_ending = False
        self._thread = threading.Thread(target=self._run, name=sink.name, daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Poses that never reached the sink, and what it dropped itself."""
        return self._lost + self._sink.dropped

    @property
    def failure(self) -> str | None:
        """Why the sink was given up; None while it works."""
        return self._failure

    def publish(self, live: LivePose) -> None:
        """Queue one pose; at once.

        Raises:
            LocalregError: the sink has failed; only the first time after it did.
        """
        with self._changed:
            if self._failure is None:
                self._waiting.append(live)
                if len(self._waiting) > self._capacity:
                    self._waiting.popleft()
                    self._lost += 1
                self._changed.notify()
                return
            self._lost += 1
        self._tell_failure()

    def close(self) -> None:
        """Let the sink finish what waits, then close it.

        Raises:
            LocalregError: it could not finish, unless that was said before.
        """
        with self._changed:
            self._is_ending = True
            self._changed.notify()
        self._thread.join(_CLOSING)
        if self._thread.is_alive():
            raise LocalregError(f"{self.name} did not finish within {_CLOSING:g} s; its end is cut")
        self._tell_failure()

    def _tell_failure(self) -> None:
        if self._failure is not None and not self._is_failure_told:
            self._is_failure_told = True
            raise LocalregError(self._failure)

    def _run(self) -> None:
        try:
            while (live := self._next()) is not None:
                self._sink.publish(live)
        except (OSError, LocalregError) as error:
            self._fail(error)
        finally:
            try:
                self._sink.close()
            except (OSError, LocalregError) as error:
                self._fail(error)

    def _next(self) -> LivePose | None:
        """The next pose to hand on; None at the end."""
        with self._changed:
            while not self._waiting and not self._is_ending:
                self._changed.wait()
            return self._waiting.popleft() if self._waiting else None

    def _fail(self, error: Exception) -> None:
        words = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        with self._changed:
            if self._failure is None:
                self._failure = f"{self.name} stopped: {words.lower()}; the motion goes on"
                self._lost += len(self._waiting)
                self._waiting.clear()
