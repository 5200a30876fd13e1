"""What a session counts and times, in memory of fixed size."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy import ndarray


class RecentTimes:
    """The newest durations, for percentiles.

    Args:
        capacity: how many are kept; 65,536 are 27 minutes at 40 Hz.
    """

    def __init__(self, capacity: int = 65_536) -> None:
        self._values = np.zeros(capacity)
        self.count = 0

    def add(self, seconds: float) -> None:
        """Take one duration [s]."""
        self._values[self.count % len(self._values)] = seconds
        self.count += 1

    @property
    def last(self) -> float:
        """The newest [s]; NaN before the first."""
        if not self.count:
            return float("nan")
        return float(self._values[(self.count - 1) % len(self._values)])

    @property
    def values(self) -> Float[ndarray, " n"]:
        """Those kept, in no particular order [s]."""
        return self._values[: self.count].copy()

    def recent(self, count: int) -> Float[ndarray, " n"]:
        """The newest ones, at most so many, in no particular order [s]."""
        newest = np.arange(max(0, self.count - count), self.count)
        return self._values[newest[-len(self._values) :] % len(self._values)]

    def percentile(self, q: float) -> float:
        """The q-th percentile, q from 0 to 100 [s]; NaN if there are none."""
        kept = self._values[: self.count]
        return float(np.percentile(kept, q)) if kept.size else float("nan")


@dataclass(slots=True)
class LiveCounters:
    """What became of the frames; only grows.

    Attributes:
        frames: instants that were due.
        late_frames: poses that came too late or, like `missing_frames`, never.
        missing_frames: instants for which no pose was published.
        passed_frames: of the missing ones, those that came but were passed over for newer
            ones, because the loop was behind.
        held_frames: published, but an earlier pose, because the frame could not be solved.
        blind_frames: frames in which not one tracker was measured.
        failed_frames: frames that the estimator gave up on.
        reacquired_frames: frames in which the estimator found the body anew by itself.
        starts: times the body was found from one frame alone: at the beginning, when the
            performer changed, and after a blindness.
        sink_errors: times a sink failed.
        latency: from the last byte of a frame's newest sample to the pose in all sinks [s].
        compute: from a frame to its pose, where one was found [s].
        last_sink_error: in words.
    """

    frames: int = 0
    late_frames: int = 0
    missing_frames: int = 0
    passed_frames: int = 0
    held_frames: int = 0
    blind_frames: int = 0
    failed_frames: int = 0
    reacquired_frames: int = 0
    starts: int = 0
    sink_errors: int = 0
    latency: RecentTimes = field(default_factory=RecentTimes)
    compute: RecentTimes = field(default_factory=RecentTimes)
    last_sink_error: str = ""

    @property
    def published(self) -> int:
        """Poses handed to the sinks."""
        return self.frames - self.missing_frames
