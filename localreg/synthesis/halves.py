"""Streams of which one half is measured: positions only, or orientations only.

What half a signal leaves open is reconstructed from the database alone, and once wrong it
stays wrong: a regression that takes its own past for as good as with both signals repeats
its mistakes. So for such streams everything is rehearsed with what they measure.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.database.features import FeatureLayout
from localreg.synthesis.attention import TRUST_IN_PLACE


class Measured(NamedTuple):
    """What is known of the trackers.

    Attributes:
        trust: in each feature column.
        coordinates: which of a tracker's are measured: position (3), orientation (3).
        reference: the tracker that features are seen from.
        turns: whether its orientation is predicted.
    """

    trust: Float[ndarray, " f"]
    coordinates: Bool[ndarray, "6"]
    reference: int
    turns: bool

    @classmethod
    def of(cls, layout: FeatureLayout, *, position: bool, orientation: bool) -> "Measured":
        """What is known where these signals are measured of every tracker."""
        count = len(layout.others) + 1
        trust = layout.trust(np.full(count, position), np.full(count, orientation), TRUST_IN_PLACE)
        coordinates = np.repeat([position, orientation], 3)
        return cls(trust, coordinates, layout.reference, not orientation)
