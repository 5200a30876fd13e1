"""Hands the newest frame to the view's process; older ones are forgotten."""

from collections.abc import Callable

from jaxtyping import Float
from numpy import ndarray

from localreg.live.sinks.base import LivePose, Sink
from localreg.view.feed import Glimpse
from localreg.view.process import ViewProcess

GhostAt = Callable[[LivePose], Float[ndarray, "63"] | None]
"""The body that a frame's is compared with; called in the live loop."""


class ViewSink(Sink):
    """Writes each frame over the one before, in memory that both processes share.

    That takes some twenty microseconds whatever the view does. Nothing is dropped that
    anybody waited for: a view wants the newest only.

    Args:
        process: who shows it; closing it is the caller's.
        ghost_at: a body to compare with.

    Attributes:
        process: as given; it may be replaced before the first pose.
    """

    name = "view"

    def __init__(self, process: ViewProcess, ghost_at: GhostAt = lambda live: None) -> None:
        self.process = process
        self._ghost_at = ghost_at

    def publish(self, live: LivePose) -> None:
        """Put the frame in place of the one before."""
        self.process.show(
            Glimpse(
                live.instant, live.frame, live.pose.qpos, float(live.pose.confidence),
                live.is_held, live.is_start, self._ghost_at(live),
            )
        )  # fmt: skip
