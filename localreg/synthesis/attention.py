"""Which trackers are heard when the neighbours are chosen.

The energy is robust and hears them all. But one tracker that jumped away would choose the
neighbours of a pose that nobody struck; so one that is far from where the motion so far
leads is doubted for a while.
"""

from typing import Final, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit
from numpy import ndarray

from localreg.synthesis.observation import Observation
from sensors.pose import TrackerFrame

LONG: Final = 1000
"""As good as never heard, in frames."""

_ROOM: Final = 1000.0
"""No tracker is farther than this from the origin, or its position is nonsense [m]."""

_JUMP: Final = 0.12
"""A tracker this far from prediction is doubted [m] ..."""

_COSINE_OF_HALF_TWIST: Final = float(np.cos(np.radians(15.0)))
"""... as is one turned by 30 degrees from it ..."""

_DOUBT: Final = 20
"""... for at most so many frames in a row."""

_LEAST_TRUST: Final = 0.05
"""Trust in what is seen from a reference pose that has long been predicted only ..."""

TRUST_IN_PLACE: Final = 0.6
"""... and where it is its orientation alone that is predicted."""


class Attention(NamedTuple):
    """Which trackers are being heard.

    Attributes:
        away: for how many frames in a row each of the J trackers has been far from where
            the motion led; `LONG` while it is masked.
        unguided: for how many frames in a row the reference tracker's pose was not heard.
    """

    away: Int[ndarray, " J"]
    unguided: int


class Heard(NamedTuple):
    """What the trackers say that are believed.

    Attributes:
        positions: measured; the reference tracker's predicted where it is not heard [m].
        quaternions: the same.
        seen: whose positions are believed.
        facing: whose orientations are.
        in_reference: trust in what is seen from the reference tracker where a part of its
            pose was predicted.
    """

    positions: Float[ndarray, "J 3"]
    quaternions: Float[ndarray, "J 4"]
    seen: Bool[ndarray, " J"]
    facing: Bool[ndarray, " J"]
    in_reference: float


def observe(frame: TrackerFrame) -> Observation:
    """A frame's arrays; what cannot be a position, or a rotation, counts as not measured."""
    positions = np.asarray(frame.positions, dtype=float)
    quaternions = np.asarray(frame.quaternions, dtype=float)
    seen, facing = np.asarray(frame.position_mask), np.asarray(frame.orientation_mask)
    out = Observation(*map(np.empty_like, (positions, quaternions, seen, facing)))
    _observe(positions, quaternions, seen, facing, out)
    return out


@njit(cache=True)
@no_type_check
def _observe(positions, quaternions, position_mask, orientation_mask, out):
    at, turned, seen, facing = out
    at[:], turned[:] = 0.0, 0.0
    for j in range(len(positions)):
        near = True
        for i in range(3):
            near = near and abs(positions[j, i]) < _ROOM  # NaN is not
        seen[j] = position_mask[j] and near
        if seen[j]:
            at[j] = positions[j]
        turned[j, 0] = 1.0
        norm = np.sqrt(np.sum(np.square(quaternions[j])))
        facing[j] = orientation_mask[j] and abs(norm - 1.0) < 0.1
        if facing[j]:
            turned[j] = quaternions[j] / norm


@njit(cache=True)
@no_type_check
def listen(observation, predicted_positions, predicted, attention, reference, away):
    """Sort out whom to believe.

    Args:
        observation: what the trackers say.
        predicted_positions: where the motion so far leads them [m].
        predicted: quaternions that they would have there.
        attention: who was heard before.
        reference: the tracker that the others are seen from.
        away: written: the next attention's.

    Returns:
        What is `Heard`, and the next attention's number of frames without guidance.
    """
    positions, quaternions = observation.positions.copy(), observation.quaternions.copy()
    seen, facing = observation.position_mask.copy(), observation.orientation_mask.copy()
    for j in range(len(positions)):
        off = np.sqrt(np.sum(np.square(positions[j] - predicted_positions[j])))
        alike = abs(np.sum(quaternions[j] * predicted[j]))
        far = (seen[j] and off > _JUMP) or (facing[j] and alike < _COSINE_OF_HALF_TWIST)
        away[j] = min(attention.away[j] + 1, LONG) if far else 0
        if not (seen[j] or facing[j]):
            away[j] = LONG
        if far and away[j] <= _DOUBT:
            seen[j] = facing[j] = False
    if not seen[reference]:
        positions[reference] = predicted_positions[reference]
    if not facing[reference]:
        quaternions[reference] = predicted[reference]
    unguided = 0 if seen[reference] and facing[reference] else min(attention.unguided + 1, LONG)
    least = TRUST_IN_PLACE if seen[reference] else _LEAST_TRUST
    trust = max(least, 0.5 * 0.8**unguided)
    return Heard(positions, quaternions, seen, facing, trust), unguided
