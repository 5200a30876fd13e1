"""The last few samples of one tracker, and which of them tell its pose at an instant."""

import bisect
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Inserted = Literal["newest", "between", "duplicate", "forgotten"]


@dataclass(frozen=True, slots=True)
class Bracket:
    """Two samples and where between (0..1) or past them (above 1) an instant lies.

    Attributes:
        older: position (3,) [m] and quaternion (4,) at fraction 0.
        newer: the same at fraction 1.
        fraction: of the way from the older to the newer.
        arrival: newest arrival of the two [s].
    """

    older: tuple[NDArray[np.float64], NDArray[np.float64]]
    newer: tuple[NDArray[np.float64], NDArray[np.float64]]
    fraction: float
    arrival: float


# Two samples closer than this [s] are one: their difference says nothing about speed.
_SAME_INSTANT = 1e-6


class TrackerHistory:
    """A short, sorted memory of fixed size.

    Args:
        capacity: samples kept; 32 are 0.18 s at the IS-900's 180 Hz and 0.8 s at 40 Hz.
    """

    def __init__(self, capacity: int = 32) -> None:
        self._capacity = capacity
        self._times: list[float] = []
        self._positions: list[NDArray[np.float64]] = []
        self._quaternions: list[NDArray[np.float64]] = []
        self._arrivals: list[float] = []

    def __len__(self) -> int:
        return len(self._times)

    @property
    def newest(self) -> float:
        """Time of the newest sample [s], -inf if there is none."""
        return self._times[-1] if self._times else -math.inf

    def insert(
        self,
        time: float,
        position: NDArray[np.float64],
        quaternion: NDArray[np.float64],
        arrival: float,
    ) -> Inserted:
        """Put a sample in its place by time.

        Returns:
            Where it went; "duplicate" and "forgotten" (older than a full memory) were not
            taken.
        """
        i = bisect.bisect_left(self._times, time)
        near = self._times[max(0, i - 1) : i + 1]
        if any(abs(time - other) < _SAME_INSTANT for other in near):
            return "duplicate"
        full = len(self._times) >= self._capacity
        if full and i == 0:
            return "forgotten"
        where: Inserted = "newest" if i == len(self._times) else "between"
        self._times.insert(i, time)
        self._positions.insert(i, position)
        self._quaternions.insert(i, quaternion)
        self._arrivals.insert(i, arrival)
        if full:
            for values in (self._times, self._positions, self._quaternions, self._arrivals):
                del values[0]
        return where

    def at(
        self, t: float, tolerance: float, max_extrapolation: float, max_gap: float
    ) -> Bracket | None:
        """The samples that tell the pose at an instant.

        Args:
            t: the instant [s].
            tolerance: a sample this near stands for the instant if nothing better can be had
                [s].
            max_extrapolation: farthest past the newest sample [s].
            max_gap: longest pause between two samples that is bridged [s].

        Returns:
            Two samples to blend, or one sample twice; None if the samples do not reach.
        """
        i = bisect.bisect_left(self._times, t)
        if 0 < i < len(self._times) and self._times[i] - self._times[i - 1] <= max_gap:
            return self._bracket(i - 1, i, t)
        nearest = [k for k in (i - 1, i) if 0 <= k < len(self._times)]
        age = t - self.newest
        if i == len(self._times) and age <= max_extrapolation:
            reference = self._speed_reference(max_gap)
            if reference is not None:
                return self._bracket(reference, i - 1, t)
        for k in nearest:
            if abs(self._times[k] - t) <= tolerance:
                return self._bracket(k, k, t)
        return None

    def _speed_reference(self, max_gap: float) -> int | None:
        # Speed from two samples a few milliseconds apart would be noise, so go back at
        # least an eighth of the bridgeable pause: half a period with the usual settings.
        for k in range(len(self._times) - 2, -1, -1):
            back = self.newest - self._times[k]
            if back > max_gap:
                return None
            if back >= 0.125 * max_gap:
                return k
        return None

    def _bracket(self, a: int, b: int, t: float) -> Bracket:
        span = self._times[b] - self._times[a]
        return Bracket(
            (self._positions[a], self._quaternions[a]),
            (self._positions[b], self._quaternions[b]),
            (t - self._times[a]) / span if a != b else 0.0,
            max(self._arrivals[a], self._arrivals[b]),
        )
