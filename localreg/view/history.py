"""The last seconds of a view's moments, as arrays for graphs."""

from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import DOF_COUNT
from localreg.view.moment import Moment

CAPACITY: Final = 400
"""Moments kept: ten seconds at 40 Hz."""


class History:
    """Rings of fixed size; times that go back begin anew.

    Args:
        trackers: how many there are.
        capacity: moments kept.
    """

    def __init__(self, trackers: int, capacity: int = CAPACITY) -> None:
        self._times = np.zeros(capacity)
        self._distances = np.full((capacity, trackers), np.nan)
        self._angles = np.zeros((capacity, DOF_COUNT))
        self._latency = np.full((capacity, 2), np.nan)
        self._confidence = np.full(capacity, np.nan)
        self._count = 0

    def __len__(self) -> int:
        return min(self._count, len(self._times))

    def add(self, moment: Moment) -> None:
        """Take a moment; one that is not later than the newest begins anew."""
        if self._count and moment.time <= self._times[(self._count - 1) % len(self._times)]:
            self._count = 0
        row = self._count % len(self._times)
        self._times[row] = moment.time
        distances = [tracker.distance for tracker in moment.trackers]
        self._distances[row] = distances or np.nan
        self._angles[row] = moment.qpos[7:]
        timing = moment.timing
        self._latency[row] = (np.nan, np.nan) if timing is None else (timing.p50, timing.p99)
        self._confidence[row] = moment.confidence
        self._count += 1

    @property
    def ages(self) -> Float[ndarray, " n"]:
        """Times before the newest, oldest first; all but the last are negative [s]."""
        times = self._in_order(self._times)
        return times - times[-1] if times.size else times

    @property
    def distances(self) -> Float[ndarray, "n J"]:
        """Of the trackers from where the body has them [m]; NaN where not measured."""
        return self._in_order(self._distances)

    @property
    def angles(self) -> Float[ndarray, "n 56"]:
        """Joint angles [rad]."""
        return self._in_order(self._angles)

    @property
    def latency(self) -> Float[ndarray, "n 2"]:
        """Median and 99th percentile of the latency [s]."""
        return self._in_order(self._latency)

    @property
    def confidence(self) -> Float[ndarray, " n"]:
        """How well the database explains what is seen."""
        return self._in_order(self._confidence)

    def _in_order(self, ring: Float[ndarray, " capacity ..."]) -> Float[ndarray, " n ..."]:
        return (
            ring[: self._count]
            if self._count < len(ring)
            else np.roll(ring, -(self._count % len(ring)), axis=0)
        )
