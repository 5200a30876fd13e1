"""The live loop: receive, assemble, synthesize, publish; and count what was too late.

Everything happens in the thread that calls `run`, except that each device reads its line
in a thread of its own, and that bodies are found from one frame in another. Nothing in here
grows with time.

A frame is late when its pose reaches the sinks more than one period after its instant plus
the assembler's delay, or never. Latency counts from the last byte of the frame's newest
sample to the moment the last sink has the pose.

On a machine that is too slow for a while frames queue up. Up to `MOST_BEHIND` they are all
solved, for then the loop catches up with a hiccup unseen; beyond it the newest wins.
"""

import contextlib
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from types import FrameType
from typing import Protocol, runtime_checkable

from localreg.errors import LocalregError
from localreg.live.counters import LiveCounters
from localreg.live.performance import EstimatorAt, Performance, Search
from localreg.live.performance_config import PerformanceConfig
from localreg.live.sinks.base import LivePose, Sink
from sensors.assembler import AssembledFrame
from sensors.devices.base import Device
from sensors.stream import FrameStream

_POLL = 0.05
"""How often the loop looks whether it is to stop, when no frames come [s]."""

MOST_BEHIND = 0.15
"""Age, beyond the buffer, at which a frame is passed over if a newer one waits [s]."""

_STEP_SHARE = 0.4
"""Share of a period that is kept for the step itself when a body is waited for."""

_IDLE_SLACK = 0.4
"""Idle work begins only if so much of a period is left before the next instant."""


@runtime_checkable
class FrameLog(Protocol):
    """Who wants to know how each frame was taken: the recording. Must not block or raise."""

    def taken(self, assembled: AssembledFrame, search: Search, live: LivePose | None) -> None:
        """A frame was taken.

        Args:
            assembled: the frame.
            search: how the search for a body stood.
            live: what is going to be published, before it is placed; None for nothing.
        """

    def passed_over(self, assembled: AssembledFrame) -> None:
        """A frame was not taken, because the loop was behind and a newer one waited."""


class Session:
    """Runs until stopped.

    Args:
        stream: where frames come from; its queue is the devices'.
        estimator_at: which estimator serves an instant; `lambda _: estimator` for a single
            performer. When it returns another object the body is found anew.
        sinks: who is handed every pose, in this order.
        devices: whose rejected records count as dropped samples; starting and stopping them
            is the caller's.
        config: what to do with frames that cannot be solved.
        executor: where bodies are found from one frame; by default a thread.
        on_idle: work that may wait, such as a display; it is called when the next frame is
            some way off, so it costs no lateness as long as it takes a few milliseconds.
        place: where in the world a frame is published, for example re-centred.
        log: who is told how every frame was taken.
        most_behind: age, beyond the buffer, at which a frame is passed over if a newer one
            waits [s]; infinite where every frame counts, whenever it comes.
        now: the clock of the frames [s].

    Attributes:
        counters: what became of the frames.
        latest: what was published last.
        turns: how often the loop has turned, with or without a frame; it stands still only
            if the loop does.
    """

    def __init__(
        self,
        stream: FrameStream,
        estimator_at: EstimatorAt,
        sinks: Sequence[Sink] = (),
        *,
        devices: Sequence[Device] = (),
        config: PerformanceConfig | None = None,
        executor: Executor | None = None,
        on_idle: Callable[[], None] | None = None,
        place: Callable[[LivePose], LivePose] | None = None,
        log: FrameLog | None = None,
        most_behind: float = MOST_BEHIND,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counters = LiveCounters()
        self.latest: LivePose | None = None
        self.turns = 0
        self._stream = stream
        self._executor = executor or ThreadPoolExecutor(1, thread_name_prefix="find-body")
        self._performance = Performance(estimator_at, self._executor, self.counters, config)
        self._sinks = tuple(sinks)
        self._devices = tuple(devices)
        self.on_idle = on_idle
        self._place = place
        self._log = log
        self._most_behind = most_behind
        self._now = now
        self._stop = threading.Event()
        self._dropped_before = 0
        self._last: tuple[int, float] | None = None

    @property
    def buffer(self) -> float:
        """The configured delay: how long a frame waits at most for its samples [s]."""
        return self._stream.assembler.config.delay

    @property
    def dropped_samples(self) -> int:
        """Samples of this run that were of no use.

        Records damaged on the line, those that fell out of a full queue, and those the
        assembler refused.
        """
        return self._all_dropped() - self._dropped_before

    @property
    def silent_for(self) -> float:
        """Time since the instant of the newest published frame [s]; infinite before it."""
        return math.inf if self.latest is None else self._now() - self.latest.frame.time

    @property
    def is_stopped(self) -> bool:
        """Whether somebody asked the loop to end."""
        return self._stop.is_set()

    def stop(self) -> None:
        """End the run after the frame in hand; from any thread, or a signal handler."""
        self._stop.set()

    def run(self, start: float = -math.inf, end: float = math.inf) -> None:
        """Serve frames until stopped, then close the sinks; once only.

        Args:
            start: frames of earlier instants are passed over [s].
            end: the run ends with the first frame at or after it, or when that frame is
                overdue [s]; instants before it without a pose count as late.

        Raises:
            LocalregError: a sink could not finish, for example write its file.
        """
        self._dropped_before = self._all_dropped()
        try:
            if self._serve(start, end):
                self._count_missing_until(end, start)
        finally:
            self._executor.shutdown(cancel_futures=True)
            for sink in self._sinks:
                sink.close()

    def _serve(self, start: float, end: float) -> bool:
        """Serve frames; true if the end was reached, false if stopped before."""
        period = self._stream.assembler.period
        while not self._stop.is_set():
            self.turns += 1
            assembled = self._next()
            if assembled is None:
                if self._now() > end + self.buffer + period:
                    return True
                continue
            if assembled.frame.time >= end:
                return True
            if assembled.frame.time >= start:
                self._take(assembled, start)
                self._idle()
        return False

    def _next(self) -> AssembledFrame | None:
        """The next frame to take; None if there is none for a while."""
        assembled = self._stream.next(_POLL)
        if assembled is None:
            return None
        if self._now() - assembled.frame.time <= self.buffer + self._most_behind:
            return assembled
        while (newer := self._stream.next(0.0)) is not None:
            self.counters.passed_frames += 1
            if self._log is not None:
                self._log.passed_over(assembled)
            assembled = newer
        return assembled

    def _take(self, assembled: AssembledFrame, start: float) -> None:
        frame, counters = assembled.frame, self.counters
        period = self._stream.assembler.period
        limit = frame.time + self.buffer + period
        self._count_missing_before(assembled, start)
        begun = self._now()
        outcome = self._performance.take(frame, max(0.0, limit - _STEP_SHARE * period - begun))
        if outcome is not None and not outcome.is_held:
            counters.compute.add(self._now() - begun)
        counters.frames += 1
        self._last = (assembled.index, frame.time)
        live = None if outcome is None else LivePose(assembled.index, frame, *outcome)
        if self._log is not None:
            self._log.taken(assembled, self._performance.search, live)
        if live is None:
            counters.missing_frames += 1
            counters.late_frames += 1
            return
        if self._place is not None:
            live = self._place(live)
        self._publish(live)
        reached = self._now()
        self.latest = live
        if not math.isnan(assembled.newest_arrival):
            counters.latency.add(reached - assembled.newest_arrival)
        if reached > limit:
            counters.late_frames += 1

    def _publish(self, live: LivePose) -> None:
        for sink in self._sinks:
            try:
                sink.publish(live)
            except (OSError, LocalregError) as error:
                self.counters.sink_errors += 1
                self.counters.last_sink_error = str(error)

    def _idle(self) -> None:
        assembler = self._stream.assembler
        slack = assembler.deadline - assembler.config.delay - self._now()
        if self.on_idle is not None and slack > _IDLE_SLACK * assembler.period:
            self.on_idle()

    def _count_missing_before(self, assembled: AssembledFrame, start: float) -> None:
        if self._last is not None:
            self._miss(assembled.index - self._last[0] - 1)
        elif math.isfinite(start):
            self._miss(math.floor((assembled.frame.time - start) / self._stream.assembler.period))

    def _count_missing_until(self, end: float, start: float) -> None:
        since = start if self._last is None else self._last[1]
        if math.isfinite(since) and math.isfinite(end):
            periods = (end - since) / self._stream.assembler.period
            # After a frame the next instant is a period away; before the first it is unknown.
            whole = periods if self._last is None else math.ceil(periods - 1e-6) - 1
            self._miss(max(0, math.floor(whole)))

    def _miss(self, frames: int) -> None:
        self.counters.frames += frames
        self.counters.missing_frames += frames
        self.counters.late_frames += frames

    def _all_dropped(self) -> int:
        bad = sum(device.counters.parser.bad_records for device in self._devices)
        return self._stream.samples.dropped + self._stream.assembler.counters.dropped + bad


@contextlib.contextmanager
def stopped_by_interrupt(session: Session) -> Iterator[None]:
    """Ctrl-C or a request to terminate ends the run cleanly; a second one the program.

    Python lets only the main thread listen; in any other this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if session.is_stopped:
            raise KeyboardInterrupt
        session.stop()

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, handle) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
