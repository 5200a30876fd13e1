"""Running figures of the samples of one tracker."""

import math
from dataclasses import dataclass


@dataclass(slots=True)
class StreamStatistics:
    """Running figures of one tracker's samples, forgetting with the given time constant.

    Attributes:
        constant: time over which the figures forget [s].
        last: newest capture [s].
        mean: mean interval between captures [s].
        variance: variance of the delay from capture to arrival [s^2].
        delay: mean delay from capture to arrival [s].
        quality: newest quality, 0 to 1.
        count: samples seen.
    """

    constant: float = 2.0
    last: float = math.nan
    mean: float = 0.0
    variance: float = 0.0
    delay: float = 0.0
    quality: float = 0.0
    count: int = 0

    def observe(self, time: float, arrival: float, quality: float) -> None:
        """Take one sample: its capture and arrival [s], and its quality."""
        delay = arrival - time
        if self.count == 0:
            self.delay = delay
        else:
            interval = time - self.last
            weight = max(1.0 / self.count, 1.0 - math.exp(-max(0.0, interval) / self.constant))
            self.mean += weight * (interval - self.mean)
            change = delay - self.delay
            self.delay += weight * change
            self.variance = (1.0 - weight) * (self.variance + weight * change * change)
        self.last, self.quality = time, quality
        self.count += 1

    @property
    def rate(self) -> float:
        """Samples a second [Hz]; 0 before the second sample."""
        return 1.0 / self.mean if self.mean > 0.0 else 0.0

    @property
    def jitter(self) -> float:
        """Standard deviation of the delay from capture to arrival [s]."""
        return math.sqrt(self.variance)
