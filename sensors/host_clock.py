"""The time that frames live on: the host's monotonic clock, or that of a recording."""

import time


class HostClock:
    """The host's monotonic clock.

    Attributes:
        speed: seconds of this clock in one second of the wall; 1 for the host's own.
    """

    speed: float = 1.0

    def now(self) -> float:
        """The present [s]."""
        return time.monotonic()


class ScaledClock(HostClock):
    """A clock that began at a given time and runs at a given speed; for replays.

    Args:
        start: what it shows now [s].
        speed: seconds in one second of the wall, above 0.
    """

    def __init__(self, start: float, speed: float = 1.0) -> None:
        self.speed = speed
        self._start = start
        self._began = time.monotonic()

    def restart(self) -> None:
        """Let it show its first time now."""
        self._began = time.monotonic()

    def now(self) -> float:
        """The present [s]."""
        return self._start + (time.monotonic() - self._began) * self.speed
