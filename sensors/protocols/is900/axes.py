"""From the tracker's reference frame to the world, and from the world to a room.

IS-900: x north, y east, z down. World: x, y horizontal, z up. Both are right-handed, so
half a turn about the common x axis relates them: S = diag(1, -1, -1) and

    p_world = S p_ned = (n, -e, -d)        R_world = S R_ned S^T.

Multiplying by S on both sides also relabels the body axes in the same way: a tracker whose
case axes are forward, right, down becomes one with forward, left, up, and a tracker that
reports no rotation has its axes along the world's. For a quaternion that is
(w, x, -y, -z). S is its own inverse, so the same function goes either way.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sensors import rotation

_S = np.array([1.0, -1.0, -1.0])
_S_QUATERNION = np.array([1.0, 1.0, -1.0, -1.0])


def flip_position(p: NDArray[np.float64]) -> NDArray[np.float64]:
    """North-east-down to world or back, shape (..., 3) [m]."""
    return p * _S


def flip_quaternion(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """North-east-down to world or back, w x y z, shape (..., 4)."""
    return q * _S_QUATERNION


@dataclass(frozen=True, slots=True)
class RoomTransform:
    """Where the tracker's world sits in the room: a turn about the vertical, then a shift.

    Attributes:
        yaw: angle about z, counterclockwise seen from above [rad].
        translation: the tracker's origin in the room, x y z [m].
    """

    yaw: float = 0.0
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # The turn as matrices from the right, for this runs for every sample: rows of positions
    # times one, rows of quaternions times the other.
    _turn: NDArray[np.float64] = field(init=False, repr=False, compare=False)
    _turn_quaternion: NDArray[np.float64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        q = np.array([math.cos(0.5 * self.yaw), 0.0, 0.0, math.sin(0.5 * self.yaw)])
        object.__setattr__(self, "_turn", rotation.rotate(q, np.eye(3)))
        object.__setattr__(self, "_turn_quaternion", rotation.multiply(q, np.eye(4)))

    def apply(
        self, p: NDArray[np.float64], q: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Tracker world to room: positions (..., 3) [m], quaternions (..., 4)."""
        return p @ self._turn + np.array(self.translation), q @ self._turn_quaternion

    def invert(
        self, p: NDArray[np.float64], q: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Room to tracker world: positions (..., 3) [m], quaternions (..., 4)."""
        # Both matrices are orthogonal.
        return (p - np.array(self.translation)) @ self._turn.T, q @ self._turn_quaternion.T
