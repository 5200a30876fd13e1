"""What a listener is, and what it is handed."""

from abc import ABC, abstractmethod
from typing import NamedTuple

from localreg.synthesis.estimator import Pose
from sensors.pose import TrackerFrame


class LivePose(NamedTuple):
    """One published frame.

    Attributes:
        instant: number of the instant on the grid of frames; a gap is a frame that never
            came, and nothing else moves the grid.
        frame: what the trackers said.
        pose: the body. Arrays may be kept but not changed.
        is_held: whether it is an earlier pose, shown again because this frame could not be
            solved.
        is_start: whether the body was found anew from this frame alone, and may have
            jumped.
    """

    instant: int
    frame: TrackerFrame
    pose: Pose
    is_held: bool
    is_start: bool


class Sink(ABC):
    """A listener. It is called in the live loop, so it must be quick and never block.

    Trouble with the world outside is an `OSError` or a `LocalregError`; the session counts
    it and goes on.

    Attributes:
        name: for messages and figures.
    """

    name: str = "sink"

    @property
    def dropped(self) -> int:
        """Poses or packets that never left, for want of time or room."""
        return 0

    @abstractmethod
    def publish(self, live: LivePose) -> None:
        """Take one pose."""

    def close(self) -> None:  # noqa: B027  (most sinks have nothing to finish)
        """Finish, after the last pose. Doing so twice is no error."""
