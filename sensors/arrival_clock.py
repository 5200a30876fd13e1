"""Capture times for senders that give none: the even beat behind uneven arrivals.

A sender works at some rate, and what is uneven about the arrivals is the way. So the beat is
followed as a phase-locked loop follows a carrier: the next report is expected one period
after the last, late ones hardly move the beat (the way delays), early ones move it at once
(the way cannot hurry).
"""

_PERIOD_GAIN = 0.02
_LATE_GAIN = 0.05
_EARLY_GAIN = 0.5
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

    @property
    def period(self) -> float:
        """Estimated time between reports [s]; 0 before there are two."""
        return self._period

    def update(self, arrival: float) -> float:
        """Take the arrival of a report [s].

        Returns:
            When it was sent, less the shortest delay of the way; never later than `arrival`
            and never earlier than the report before.
        """
        if self._beat is None or not 0.0 <= arrival - self._beat <= _MAX_PERIOD:
            self._restart(arrival)
            return arrival
        if self._count < _SETTLE:
            # Not yet sure of the period: the plain mean of what was seen.
            self._count += 1
            self._period += (arrival - self._beat - self._period) / self._count
            self._beat = arrival
            return arrival
        # Lost reports leave out whole beats.
        beats = max(1, round((arrival - self._beat) / self._period)) if self._period > 0.0 else 1
        expected = self._beat + beats * self._period
        error = arrival - expected
        if abs(error) > 0.5 * max(self._period, 1e-3):
            self._restart(arrival)
            return arrival
        self._period += _PERIOD_GAIN * error / beats
        beat = expected + (_EARLY_GAIN if error < 0.0 else _LATE_GAIN) * error
        self._beat = max(self._beat, min(arrival, beat))
        return self._beat

    def _restart(self, arrival: float) -> None:
        self._beat, self._period, self._count = arrival, 0.0, 0
