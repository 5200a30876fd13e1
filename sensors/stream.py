"""From devices to frames while running: a bounded queue and the loop around the assembler."""

import math
import threading
import time
from collections import deque
from typing import NamedTuple

from sensors.assembler import AssembledFrame, FrameAssembler
from sensors.pose import PoseSample


class Received(NamedTuple):
    """A sample and when its last byte had arrived.

    Attributes:
        sample: the pose, stamped with its capture time.
        arrival: host's monotonic time at which the last byte was in memory [s].
    """

    sample: PoseSample
    arrival: float


class SampleQueue:
    """Carries samples from reader threads to one consumer.

    Never blocks a reader: when full the oldest sample gives way and is counted, since for
    live use the newest matter.

    Args:
        capacity: samples held; 1024 are 4 s of six trackers at 40 Hz.
    """

    def __init__(self, capacity: int = 1024) -> None:
        self.dropped = 0
        self._items: deque[Received] = deque()
        self._capacity = capacity
        self._ready = threading.Condition()
        self._woken = False

    def put(self, received: list[Received]) -> None:
        """Add samples that arrived together, in one wake-up."""
        with self._ready:
            self._items.extend(received)
            while len(self._items) > self._capacity:
                self._items.popleft()
                self.dropped += 1
            self._ready.notify()

    def drain(self, timeout: float) -> list[Received]:
        """Take everything there is, waiting up to `timeout` [s] for something.

        Returns:
            Samples in order of arrival; empty after the timeout or `wake`.
        """
        with self._ready:
            if not self._items and not self._woken and timeout > 0.0:
                self._ready.wait(timeout)
            self._woken = False
            items = list(self._items)
            self._items.clear()
            return items

    def wake(self) -> None:
        """Let a waiting `drain` return at once."""
        with self._ready:
            self._woken = True
            self._ready.notify()


class FrameStream:
    """Yields frames as they close: waits for samples, never past a frame's deadline.

    Args:
        samples: where the devices put their samples.
        assembler: what makes frames of them.
    """

    def __init__(self, samples: SampleQueue, assembler: FrameAssembler) -> None:
        self.samples = samples
        self.assembler = assembler
        self._closed: deque[AssembledFrame] = deque()

    def next(self, timeout: float) -> AssembledFrame | None:
        """The next frame.

        Args:
            timeout: how long to wait at most [s].

        Returns:
            The oldest frame not yet handed out, or None after the timeout.
        """
        give_up = time.monotonic() + timeout
        while True:
            for sample, arrival in self.samples.drain(0.0):
                self.assembler.push(sample, arrival)
            now = time.monotonic()
            self._closed.extend(self.assembler.poll(now))
            if self._closed:
                return self._closed.popleft()
            wait = min(give_up, self.assembler.deadline) - now
            if now >= give_up:
                return None
            if math.isfinite(wait) and wait > 0.0:
                for sample, arrival in self.samples.drain(wait):
                    self.assembler.push(sample, arrival)
