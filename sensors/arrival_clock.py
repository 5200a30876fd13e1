"""Capture times for senders that give none: the even beat behind uneven arrivals.

A sender works at some rate, and what is uneven about the arrivals is the way. So the beat is
followed as a phase-locked loop follows a carrier: the next report is expected one period
after the last; a late one hardly moves the beat (the way delays), an early one moves it a
lot (the way cannot hurry). The beat thus settles near the shortest delay. Simulated, with 5 %
of the reports lost and delays of 3 ms (exponential) at 40 Hz, or 1 ms at 90 Hz, the times
scatter by 1.2 and 0.2 ms. Delays longer than a beat cannot be told from losses: there the
result is no better than the arrivals.
"""

import math

_LATE_GAIN = 0.02
_EARLY_GAIN = 0.3
_PERIOD_SHARE = 0.05
# A report that claims to be older than this was not late: the beat is wrong.
_MAX_LATE = 0.05
_PACE_GAIN = 1.0 / 16.0
_LEAST_PACE = 0.7
_SETTLE = 8
_MAX_PERIOD = 0.5


class ArrivalClock:
    """Smooths the arrival times of one sender's reports."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the beat."""
        self._beat: float | None = None
        self._period = 0.0
        self._count = 0
        self._pace = 1.0

    @property
    def period(self) -> float:
        """Estimated time between reports [s]; 0 before there are two."""
        return self._period

    def update(self, arrival: float) -> float:
        """Take the arrival of a report [s].

        Returns:
            When it was sent, less the shortest delay of the way; never later than `arrival`.
        """
        if self._beat is None or not 0.0 < arrival - self._beat <= _MAX_PERIOD:
            return self._restart(arrival)
        if self._count < _SETTLE:
            # Not yet sure of the period: the plain mean of what was seen.
            self._count += 1
            self._period += (arrival - self._beat - self._period) / self._count
            self._beat = arrival
            return arrival
        # Lost reports leave out whole beats; one that is late by half a beat is only late. No
        # beat at all: the report before was so late that it took the place of this one.
        beats = max(0, math.floor((arrival - self._beat) / self._period + 0.25))
        self._pace += _PACE_GAIN * (beats - self._pace)
        if self._pace < _LEAST_PACE:
            # Too often for mere lateness: the sender is faster now.
            return self._restart(arrival)
        expected = self._beat + beats * self._period
        error = arrival - expected
        correction = (_EARLY_GAIN if error < 0.0 else _LATE_GAIN) * error
        self._period += _PERIOD_SHARE * correction / max(1, beats)
        self._beat = min(arrival, max(expected + correction, arrival - _MAX_LATE))
        return self._beat

    def _restart(self, arrival: float) -> float:
        self._beat, self._period, self._count, self._pace = arrival, 0.0, 0, 1.0
        return arrival
