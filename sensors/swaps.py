"""Notices that two trackers have changed places: mixed-up cables, or identities at the source.

No tracker moves from one hand to the other within two frames. So a pair is reported if each
is now where the other was expected, and neither is where it was expected itself.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

# A sample before the exchange and one after it may be blended in one frame, so expectations
# come from two reports back, which are clean.
_BACK = 2
# Older reports say nothing about where a tracker should be now.
_MAX_AGE = 0.3
_QUIET = 0.25


class SwapDetector:
    """Watches the positions of successive frames.

    Args:
        trackers: names in the order of the rows.
        distance: jumps of less are motion [m].
    """

    def __init__(self, trackers: Sequence[str], distance: float) -> None:
        self._trackers = tuple(trackers)
        self._distance = distance
        self._past: list[deque[tuple[float, NDArray[np.float64]]]] = [
            deque(maxlen=_BACK + 1) for _ in self._trackers
        ]
        self._reported: dict[tuple[str, str], float] = {}

    def observe(
        self, t: float, positions: NDArray[np.float64], mask: NDArray[np.bool_]
    ) -> tuple[tuple[str, str], ...]:
        """Take a frame.

        Args:
            t: its instant [s].
            positions: shape (J, 3) [m].
            mask: which of them were measured, shape (J,).

        Returns:
            Pairs of names that have just changed places.
        """
        now = np.where(mask[:, None], positions, np.nan)
        swaps: list[tuple[str, str]] = []
        expected = np.array([_expected(past, t) for past in self._past])
        # Row i, column j: from where i is to where j was expected. NaN compares false.
        away = np.linalg.norm(now[:, None] - expected[None], axis=-1)
        jumped = np.diagonal(away) > self._distance
        there = away < 0.5 * self._distance
        for i, j in zip(*np.nonzero(np.triu(there & there.T, 1)), strict=True):
            if jumped[i] and jumped[j] and self._is_news(t, int(i), int(j)):
                swaps.append((self._trackers[i], self._trackers[j]))
        for j in np.flatnonzero(mask):
            self._past[j].append((t, positions[j].copy()))
        return tuple(swaps)

    def _is_news(self, t: float, i: int, j: int) -> bool:
        pair = (self._trackers[i], self._trackers[j])
        is_news = t - self._reported.get(pair, -np.inf) > _QUIET
        if is_news:
            self._reported[pair] = t
        return bool(is_news)


def _expected(past: deque[tuple[float, NDArray[np.float64]]], t: float) -> NDArray[np.float64]:
    """Where a tracker should be by now, NaN if nobody knows."""
    if len(past) <= _BACK or t - past[1][0] > _MAX_AGE:
        return np.full(3, np.nan)
    (t0, p0), (t1, p1) = past[0], past[1]
    return p1 + (p1 - p0) * ((t - t1) / max(t1 - t0, 1e-6))
