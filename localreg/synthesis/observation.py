"""What the trackers say at one instant, as synthesis wants it."""

from typing import NamedTuple

from jaxtyping import Bool, Float
from numpy import ndarray


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
