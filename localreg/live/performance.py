"""One performer's way through the frames: when to step, when to hold, when to begin anew.

The estimator never fails, but it can be blind, give up, or be replaced. The rules:

- *No tracker measured.* For up to `coast` the estimator goes on by itself, for a moving
  body looks worse frozen than guessed. After that its guess would be a dream of its own,
  so the last good pose is held.
- *Given up, or not finite.* The last good pose is held for this frame. After `patience`
  such frames in a row the state is worthless and thrown away.
- *Another estimator than before*, or trackers back after more than a coast: the body is
  found from this frame alone, as soon as `min_trackers` are measured.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.live.counters import LiveCounters
from localreg.synthesis.estimator import AnyEstimator, Pose, Result
from sensors.pose import TrackerFrame

EstimatorAt = Callable[[float], AnyEstimator]
"""Which estimator serves the frame of an instant [s]; another object is another performer."""


@dataclass(frozen=True, slots=True)
class PerformanceConfig:
    """Settings; see the module for what they mean.

    Attributes:
        coast: longest time without any tracker that the estimator bridges by itself [s].
        patience: frames in a row that may fail before the body is found anew.
        min_trackers: so many trackers must be measured to find a body from one frame; all
            of them if a subject wears fewer.
    """

    coast: float = 0.1
    patience: int = 8
    min_trackers: int = 3


class Outcome(NamedTuple):
    """What there is to publish: a pose, whether it is an earlier one, and whether it is new."""

    pose: Pose
    is_held: bool
    is_start: bool


class Performance:
    """Carries state and last good pose from frame to frame.

    Args:
        estimator_at: chooses the estimator; called once a frame.
        counters: where blind, failed and held frames are counted.
        config: settings.
    """

    def __init__(
        self,
        estimator_at: EstimatorAt,
        counters: LiveCounters | None = None,
        config: PerformanceConfig | None = None,
    ) -> None:
        self.counters = counters or LiveCounters()
        self._estimator_at = estimator_at
        self._config = config or PerformanceConfig()
        self._estimator: AnyEstimator | None = None
        self._state: Any = None
        self._good: Pose | None = None
        self._seen: float | None = None
        self._failures = 0

    def take(self, frame: TrackerFrame) -> Outcome | None:
        """The pose for a frame; None while there has never been one."""
        estimator = self._estimator_at(frame.time)
        if estimator is not self._estimator:
            self._estimator, self._state, self._failures = estimator, None, 0
        measured = int(np.count_nonzero(frame.position_mask | frame.orientation_mask))
        if not measured:
            self.counters.blind_frames += 1
            if self._state is None or self._since_seen(frame.time) > self._config.coast:
                return self._hold(frame)
        elif self._since_seen(frame.time) > self._config.coast:
            self._state = None
        is_start = self._state is None
        if is_start:
            if measured < min(self._config.min_trackers, len(frame.position_mask)):
                return self._hold(frame)
            self.counters.starts += 1
            self._state = estimator.init(frame)
        if measured:
            self._seen = frame.time
        state, pose = estimator.step(self._state, frame)
        if is_start:
            # The step only reads the pose out: the next frame is the second, not the third.
            state = self._state
        is_finite = bool(np.isfinite(pose.qpos).all())
        if is_finite:
            self._state = state
        if not is_finite or pose.result == Result.FAILED:
            self.counters.failed_frames += 1
            self._failures += 1
            if self._failures >= self._config.patience:
                self._state, self._failures = None, 0
            return self._hold(frame)
        self._failures = 0
        self.counters.reacquired_frames += pose.result == Result.REACQUIRED
        self._good = pose
        return Outcome(pose, False, is_start or pose.result == Result.REACQUIRED)

    def _since_seen(self, time: float) -> float:
        return 0.0 if self._seen is None else time - self._seen

    def _hold(self, frame: TrackerFrame) -> Outcome | None:
        """The last good pose under the present instant."""
        if self._good is None:
            return None
        self.counters.held_frames += 1
        J = len(frame.position_mask)
        held = self._good._replace(
            time=frame.time,
            position_residuals=np.full(J, np.nan),
            orientation_residuals=np.full(J, np.nan),
            confidence=float("nan"),
            steps=0,
            result=Result.FAILED,
        )
        return Outcome(held, True, False)


def tracker_residual(pose: Pose) -> float:
    """Mean distance of measured trackers from the body [m]; NaN if none was measured."""
    residuals: Float[ndarray, " J"] = np.asarray(pose.position_residuals)
    known = residuals[np.isfinite(residuals)]
    return float(known.mean()) if known.size else float("nan")
