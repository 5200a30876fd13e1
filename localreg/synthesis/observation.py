"""What the trackers say at one instant, as synthesis wants it."""

from typing import Literal, NamedTuple

from jaxtyping import Bool, Float
from numpy import ndarray

Signals = Literal["both", "position", "orientation"]
"""Which half of the trackers' poses is measured."""


class Observation(NamedTuple):
    """A `TrackerFrame` without its time, and without what cannot be a pose.

    Attributes:
        positions: of the J trackers [m].
        quaternions: turn tracker axes into world axes, w x y z.
        position_mask: which positions are measured.
        orientation_mask: which orientations are.
    """

    positions: Float[ndarray, "J 3"]
    quaternions: Float[ndarray, "J 4"]
    position_mask: Bool[ndarray, " J"]
    orientation_mask: Bool[ndarray, " J"]

    @property
    def signals(self) -> Signals | None:
        """What is measured of any tracker; None if nothing is."""
        seen, facing = self.position_mask.any(), self.orientation_mask.any()
        if seen and facing:
            return "both"
        return "position" if seen else "orientation" if facing else None
