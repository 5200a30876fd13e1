"""Whether a person holds still, from the trackers alone."""

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from sensors.pose import TrackerFrame

_LEAST_FRAMES: Final = 5


@dataclass(frozen=True, slots=True)
class StillnessSettings:
    """When a body counts as still.

    Attributes:
        window: how long must be still [s].
        speed: slower than this [m/s], trend over the window, noise averaged out.
        turn: slower than this [rad/s].
    """

    window: float = 0.6
    speed: float = 0.05
    turn: float = 0.35


class StillnessDetector:
    """Looks at the newest frames; pure, with time from the frames themselves.

    The speed of a tracker is the slope of a straight line through the window, which averages
    its noise: 3 mm over 24 frames at 40 Hz leave 4 mm/s.

    Args:
        settings: thresholds.
    """

    def __init__(self, settings: StillnessSettings | None = None) -> None:
        self.settings = settings or StillnessSettings()
        self._frames: deque[TrackerFrame] = deque()

    def reset(self) -> None:
        """Forget everything."""
        self._frames.clear()

    def push(self, frame: TrackerFrame) -> bool:
        """Take a frame; whether the body has been still for the whole window."""
        frames = self._frames
        if frames and not 0.0 < frame.time - frames[-1].time < 0.6 * self.settings.window:
            frames.clear()  # a gap: nobody knows what happened meanwhile
        frames.append(frame)
        while len(frames) > 1 and frame.time - frames[1].time >= self.settings.window:
            frames.popleft()
        spans = frame.time - frames[0].time >= 0.9 * self.settings.window
        if not spans or len(frames) < _LEAST_FRAMES:
            return False
        speed, turn = self.speeds()
        return speed < self.settings.speed and turn < self.settings.turn

    def speeds(self) -> tuple[float, float]:
        """Of the fastest tracker: speed [m/s] and rate of turn [rad/s]; 0 without any."""
        frames = list(self._frames)
        times = np.array([frame.time for frame in frames])
        times -= times.mean()
        spread = float(times @ times)
        if spread <= 0.0:
            return 0.0, 0.0
        positions = np.array([frame.positions for frame in frames])
        quaternions = np.array([frame.quaternions for frame in frames])
        seen = np.all([frame.position_mask for frame in frames], axis=0)
        turned = np.all([frame.orientation_mask for frame in frames], axis=0)
        speeds = np.linalg.norm(_slope(times, spread, positions), axis=-1)[seen]
        # q and -q are one rotation: all on the side of the first.
        sides = np.sign(np.sum(quaternions * quaternions[:1], axis=-1, keepdims=True))
        rates = 2.0 * np.linalg.norm(_slope(times, spread, quaternions * sides), axis=-1)[turned]
        return float(speeds.max(initial=0.0)), float(rates.max(initial=0.0))


def _slope(
    times: Float[ndarray, " n"], spread: float, values: Float[ndarray, "n J k"]
) -> Float[ndarray, "J k"]:
    return np.einsum("n,njk->jk", times, values) / spread
