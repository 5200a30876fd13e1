"""One performer's way through the frames: when to step, when to hold, when to begin anew.

The estimator never fails, but it can be blind, give up, or be replaced. The rules:

- *No tracker measured.* For up to `coast` the estimator goes on by itself, for a moving
  body looks worse frozen than guessed. After that its guess would be a dream of its own,
  so the last good pose is held.
- *Given up, or not finite.* The last good pose is held for this frame. After `patience`
  such frames in a row the state is worthless and thrown away.
- *Another estimator than before*, or trackers back after more than a coast: the body is
  found from this frame alone, as soon as `min_trackers` are measured.

Finding a body solves from many starts, which takes 10 ms on a core of its own and 50 ms on
a busy one, so it is done by an executor. Frames that come meanwhile show the last good pose
in time, and once it is found they are caught up with, so that the body is where it would be
without haste. After `max_waiting` of them the loop waits: better late than a frozen body.
"""

from collections.abc import Callable
from concurrent.futures import Executor, Future, wait
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.live.counters import LiveCounters
from localreg.live.performance_config import PerformanceConfig
from localreg.synthesis.estimator import AnyEstimator, Pose, Result
from sensors.pose import TrackerFrame

EstimatorAt = Callable[[float], AnyEstimator]
"""Which estimator serves the frame of an instant [s]; another object is another performer."""

Wait = Callable[[Future[Any], float | None], bool]
"""Waits for a search for so long [s], None without end; returns whether it is done."""

Search = Literal["none", "waiting", "found"]
"""Whether a frame came while a body was being found, and whether it was found then."""


class Outcome(NamedTuple):
    """What there is to publish: a pose, whether it is an earlier one, and whether it is new."""

    pose: Pose
    is_held: bool
    is_start: bool


class Performance:
    """Carries state and last good pose from frame to frame.

    Args:
        estimator_at: chooses the estimator; called once a frame.
        executor: where bodies are found from one frame.
        counters: where blind, failed and held frames are counted.
        config: settings.
        wait: how a body that is being found is waited for; by default by the clock.

    Attributes:
        search: how the search stood with the last frame. That depends on the clock alone,
            so who knows it can repeat a run exactly.
    """

    def __init__(
        self,
        estimator_at: EstimatorAt,
        executor: Executor,
        counters: LiveCounters | None = None,
        config: PerformanceConfig | None = None,
        wait: Wait | None = None,
    ) -> None:
        self.counters = counters or LiveCounters()
        self.search: Search = "none"
        self._wait = wait or _is_done_within
        self._estimator_at = estimator_at
        self._executor = executor
        self._config = config or PerformanceConfig()
        self._estimator: AnyEstimator | None = None
        self._state: Any = None
        self._good: Pose | None = None
        self._seen: float | None = None
        self._failures = 0
        self._search_begun: Future[Any] | None = None
        self._waiting: list[TrackerFrame] = []

    def take(self, frame: TrackerFrame, budget: float = 0.0) -> Outcome | None:
        """The pose for a frame.

        Args:
            frame: what the trackers say.
            budget: how long it may wait for a body to be found [s].

        Returns:
            None while there has never been a pose.
        """
        self.search = "none"
        estimator = self._estimator_at(frame.time)
        if estimator is not self._estimator:
            self._estimator, self._failures = estimator, 0
            self._forget()
        measured = int(np.count_nonzero(frame.position_mask | frame.orientation_mask))
        if not measured:
            self.counters.blind_frames += 1
            if self._state is None or self._since_seen(frame.time) > self._config.coast:
                return self._hold(frame)
        elif self._since_seen(frame.time) > self._config.coast:
            self._forget()
        if self._state is None:
            return self._find(estimator, frame, measured, budget)
        if measured:
            self._seen = frame.time
        state, pose = estimator.step(self._state, frame)
        return self._judge(frame, state, pose, False)

    def _find(
        self, estimator: AnyEstimator, frame: TrackerFrame, measured: int, budget: float
    ) -> Outcome | None:
        """Have the body found, and catch up when it is."""
        if self._search_begun is None:
            if measured < min(self._config.min_trackers, len(frame.position_mask)):
                return self._hold(frame)
            self.counters.starts += 1
            self._search_begun = self._executor.submit(estimator.init, frame)
        self._seen = frame.time
        self._waiting.append(frame)
        is_patient = len(self._waiting) <= self._config.max_waiting
        if not self._wait(self._search_begun, budget if is_patient else None):
            self.search = "waiting"
            return self._hold(frame)
        self.search = "found"
        state, frames = self._search_begun.result(), self._waiting
        self._forget()
        # The step on the first frame only reads the pose out: the second is the second.
        following, pose = estimator.step(state, frames[0])
        if len(frames) == 1:
            following = state
        for later in frames[1:]:
            state, pose = estimator.step(state, later)
            following = state
        return self._judge(frame, following, pose, True)

    def _judge(self, frame: TrackerFrame, state: Any, pose: Pose, is_start: bool) -> Outcome | None:
        """Take over a pose and the state after it, or hold the pose before."""
        is_finite = bool(np.isfinite(pose.qpos).all())
        if is_finite:
            self._state = state
        if not is_finite or pose.result == Result.FAILED:
            self.counters.failed_frames += 1
            self._failures += 1
            if self._failures >= self._config.patience:
                self._failures = 0
                self._forget()
            return self._hold(frame)
        self._failures = 0
        self.counters.reacquired_frames += pose.result == Result.REACQUIRED
        self._good = pose
        return Outcome(pose, False, is_start or pose.result == Result.REACQUIRED)

    def _forget(self) -> None:
        """The next frame begins anew; a search that is under way is not waited for."""
        self._state, self._search_begun, self._waiting = None, None, []

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


def _is_done_within(search: Future[Any], budget: float | None) -> bool:
    return bool(wait([search], budget).done)


def tracker_residual(pose: Pose) -> float:
    """Mean distance of measured trackers from the body [m]; NaN if none was measured."""
    residuals: Float[ndarray, " J"] = np.asarray(pose.position_residuals)
    known = residuals[np.isfinite(residuals)]
    return float(known.mean()) if known.size else float("nan")
