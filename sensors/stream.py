"""From devices to frames while running: a bounded queue and the loop around the assembler."""

import math
import threading
from collections import deque
from typing import NamedTuple, Protocol, runtime_checkable

from sensors.assembler import AssembledFrame, FrameAssembler
from sensors.host_clock import HostClock
from sensors.placement import RoomTransform
from sensors.pose import PoseSample
from sensors.room import Room


class Received(NamedTuple):
    """A sample and when its last byte had arrived.

    Attributes:
        sample: the pose, stamped with its capture time.
        arrival: host's monotonic time at which the last byte was in memory [s].
    """

    sample: PoseSample
    arrival: float


class Drained(NamedTuple):
    """What came out of the queue at once.

    Attributes:
        received: samples in order of arrival.
        first: number of the first of them since the queue was made, counting those that
            were dropped before they could be taken.
        dropped: how many were dropped just before `first`.
    """

    received: list[Received]
    first: int
    dropped: int


class SampleQueue:
    """Carries samples from reader threads to one consumer.

    Never blocks a reader: when full the oldest sample gives way and is counted, since for
    live use the newest matter.

    Args:
        capacity: samples held; 1024 are 4 s of six trackers at 40 Hz.

    Attributes:
        dropped: samples that gave way; only grows.
        ordered: held by who must know that nobody else puts samples meanwhile.
    """

    def __init__(self, capacity: int = 1024) -> None:
        self.dropped = 0
        self.ordered = threading.RLock()
        self._items: deque[Received] = deque()
        self._capacity = capacity
        self._ready = threading.Condition(self.ordered)
        self._woken = False
        self._taken = 0
        self._dropped_since = 0

    def put(self, received: list[Received]) -> None:
        """Add samples that arrived together, in one wake-up."""
        with self._ready:
            self._items.extend(received)
            while len(self._items) > self._capacity:
                self._items.popleft()
                self.dropped += 1
                self._dropped_since += 1
            self._ready.notify()

    def drain(self, timeout: float) -> list[Received]:
        """Take everything there is, waiting up to `timeout` [s] for something.

        Returns:
            Samples in order of arrival; empty after the timeout or `wake`.
        """
        return self.drain_numbered(timeout).received

    def drain_numbered(self, timeout: float) -> Drained:
        """As `drain`, with the numbers of the samples."""
        with self._ready:
            if not self._items and not self._woken and timeout > 0.0:
                self._ready.wait(timeout)
            self._woken = False
            items = list(self._items)
            self._items.clear()
            dropped, self._dropped_since = self._dropped_since, 0
            first = self._taken + dropped
            self._taken = first + len(items)
            return Drained(items, first, dropped)

    def wake(self) -> None:
        """Let a waiting `drain` return at once."""
        with self._ready:
            self._woken = True
            self._ready.notify()


@runtime_checkable
class FrameSink(Protocol):
    """Who wants to know how frames came about: the recorder. Must not block or raise."""

    def frame(self, assembled: AssembledFrame, taken: int) -> None:
        """A frame was closed when so many samples had been taken from the queue."""

    def dropped(self, first: int, count: int) -> None:
        """Samples of these numbers gave way in the full queue."""

    def room(self, transform: RoomTransform) -> None:
        """Frames closed from now on are placed so."""


class FrameStream:
    """Yields frames as they close: waits for samples, never past a frame's deadline.

    Args:
        samples: where the devices put their samples.
        assembler: what makes frames of them.
        room: where the trackers' world sits in the room; it may be moved while running.
        clock: what the times of samples and frames are on.
        recorder: who gets every closed frame.
    """

    def __init__(
        self,
        samples: SampleQueue,
        assembler: FrameAssembler,
        *,
        room: Room | None = None,
        clock: HostClock | None = None,
        recorder: FrameSink | None = None,
    ) -> None:
        self.samples = samples
        self.assembler = assembler
        self.clock = clock or HostClock()
        self.room = room or Room()
        self._recorder = recorder
        self._placed: RoomTransform | None = None
        self._taken = 0
        self._closed: deque[AssembledFrame] = deque()

    def next(self, timeout: float) -> AssembledFrame | None:
        """The next frame, placed in the room.

        Args:
            timeout: how long to wait at most, on the clock of the frames [s].

        Returns:
            The oldest frame not yet handed out, or None after the timeout.
        """
        clock = self.clock
        give_up = clock.now() + timeout
        while True:
            self._push(0.0)
            now = clock.now()
            self._close(now)
            if self._closed:
                return self._closed.popleft()
            wait = min(give_up, self.assembler.deadline) - now
            if now >= give_up:
                return None
            if math.isfinite(wait) and wait > 0.0:
                self._push(wait / clock.speed)

    def _push(self, timeout: float) -> None:
        drained = self.samples.drain_numbered(timeout)
        if drained.dropped and self._recorder is not None:
            self._recorder.dropped(drained.first - drained.dropped, drained.dropped)
        for sample, arrival in drained.received:
            self.assembler.push(sample, arrival)
        self._taken = drained.first + len(drained.received)

    def _close(self, now: float) -> None:
        closed = self.assembler.poll(now)
        if not closed:
            return
        # One transform for all that close together: that is what the recording can say.
        transform = self.room.transform
        if self._recorder is not None and transform is not self._placed:
            self._recorder.room(transform)
        self._placed = transform
        for assembled in closed:
            placed = assembled.placed(transform)
            if self._recorder is not None:
                self._recorder.frame(placed, self._taken)
            self._closed.append(placed)
