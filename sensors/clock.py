"""Device time to host time.

A sample is stamped by the device when it was measured, and by the host when its last byte
arrived. Arrival minus device time is offset + drift + transport delay, and the delay is
never negative and sometimes close to its smallest. So the offset and drift are those of the
line that runs under all points (the lower envelope), not through their middle: queues on
the way then cannot push it about.

The line: among all lines under the points, the one with the smallest sum of distances is
the edge of the lower convex hull above which the mean abscissa lies (Moon, Skelly and
Towsley, "Estimation and Removal of Clock Skew from Network Delay Measurements", INFOCOM
1999). Minima over buckets of a second stand for the points, so the work is small and the
memory fixed.

What the line cannot know is the smallest delay itself; it is taken as zero. Six stations of
37 bytes at 115200 baud share one device time, and the fastest needs 3.2 ms: a constant that
the device settings may subtract.
"""

import itertools
from collections import deque

_SETTLED_BUCKETS = 10
_SETTLED_DELAY = 0.02


class DeviceClock:
    """Maps the times of one device to the host's monotonic clock.

    float32 milliseconds lose the last millisecond after 4.7 h, and counters start anew when
    somebody zeroes them or switches the device off: a step is recognized and begins a new
    segment instead of bending the line.

    Args:
        window: how far back points count [s].
        bucket: one minimum is kept for each span of this length [s].
        max_drift: largest believable drift, 5e-4 is 43 s a day [s/s].
        step: a jump of the device time against the host larger than this is a reset [s].
        patience: a sudden delay beyond `step` is a burst from a full buffer if it is over
            within this time, else a reset [s].
    """

    def __init__(
        self,
        *,
        window: float = 60.0,
        bucket: float = 1.0,
        max_drift: float = 5e-4,
        step: float = 0.5,
        patience: float = 2.0,
    ) -> None:
        self.resets = 0
        self._bucket = bucket
        self._max_drift = max_drift
        self._step = step
        self._patience = patience
        self._minima: deque[tuple[float, float]] = deque(maxlen=max(2, round(window / bucket)))
        self._clear()

    def _clear(self) -> None:
        self._minima.clear()
        self._open: tuple[float, float] | None = None
        self._open_since = 0.0
        self._last_device: float | None = None
        self._late_since: float | None = None
        self._origin = 0.0
        self._offset = 0.0
        self._slope = 0.0

    def reset(self) -> None:
        """Forget everything: the device was set up anew."""
        self._clear()

    @property
    def drift(self) -> float:
        """How much faster the host's clock runs than the device's [s/s]."""
        return self._slope

    def to_host(self, device_time: float) -> float:
        """Host time of a device time by the present line [s]."""
        return device_time + self._offset + self._slope * (device_time - self._origin)

    def update(self, device_time: float, arrival: float) -> float:
        """Take one sample's times and map the first.

        Args:
            device_time: time stamp of the device [s].
            arrival: when the host had the sample's last byte [s], monotonic.

        Returns:
            Capture time on the host's clock [s], never later than `arrival`.
        """
        if self._last_device is not None and self._is_step(device_time, arrival):
            self.resets += 1
            self._clear()
        delay = arrival - device_time
        if self._last_device is None:
            self._origin, self._offset, self._open_since = device_time, delay, arrival
            self._last_device = device_time
        self._last_device = max(self._last_device, device_time)
        below = arrival - self.to_host(device_time)
        if below < 0.0:
            self._offset += below
        if self._open is None or delay < self._open[1]:
            self._open = (device_time, delay)
        if arrival - self._open_since >= self._bucket:
            self._minima.append(self._open)
            self._open, self._open_since = None, arrival
            self._fit()
        return min(arrival, self.to_host(device_time))

    def _is_step(self, device_time: float, arrival: float) -> bool:
        # Backward: only a reset or a wrap. Forward beyond the arrival: a sample cannot come
        # from the future. Late: perhaps a buffer that emptied at once, so wait and see.
        assert self._last_device is not None  # noqa: S101
        delay = arrival - self.to_host(device_time)
        if device_time < self._last_device - 0.2 * self._step or delay < -self._step:
            return True
        if delay <= self._step:
            self._late_since = None
            return False
        if self._late_since is None:
            self._late_since = arrival
        return arrival - self._late_since > self._patience

    def _fit(self) -> None:
        # Nothing near the line for many seconds: not a queue but a step too small to be seen
        # at once. Only what came after it counts.
        recent = list(self._minima)[-_SETTLED_BUCKETS:]
        if len(recent) == _SETTLED_BUCKETS and all(
            x + y - self.to_host(x) > _SETTLED_DELAY for x, y in recent
        ):
            self._minima.clear()
            self._minima.extend(recent)
        points = list(self._minima)
        span = points[-1][0] - points[0][0]
        slope = self._slope
        # A tenth of a millisecond of noise over 10 s is 1e-5, harmless; over 1 s it is not.
        if span >= 10.0 * self._bucket:
            slope = _supporting_slope(points)
        self._slope = min(self._max_drift, max(-self._max_drift, slope))
        self._origin = points[-1][0]
        self._offset = min(y - self._slope * (x - self._origin) for x, y in points)


def _supporting_slope(points: list[tuple[float, float]]) -> float:
    """Slope of the lower hull edge above which the mean abscissa lies."""
    hull: list[tuple[float, float]] = []
    for x, y in sorted(points):
        while len(hull) >= 2:
            (x0, y0), (x1, y1) = hull[-2], hull[-1]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        hull.append((x, y))
    mean = sum(x for x, _ in points) / len(points)
    for (x0, y0), (x1, y1) in itertools.pairwise(hull):
        if x1 >= mean and x1 > x0:
            return (y1 - y0) / (x1 - x0)
    return 0.0
