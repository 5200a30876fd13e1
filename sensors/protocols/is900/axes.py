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
from dataclasses import dataclass

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

    def apply(
        self, p: NDArray[np.float64], q: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Tracker world to room: positions (..., 3) [m], quaternions (..., 4)."""
        q_yaw = self._turn()
        return (
            rotation.rotate(q_yaw, p) + np.array(self.translation),
            rotation.multiply(q_yaw, q),
        )

    def invert(
        self, p: NDArray[np.float64], q: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Room to tracker world: positions (..., 3) [m], quaternions (..., 4)."""
        q_back = rotation.conjugate(self._turn())
        return (
            rotation.rotate(q_back, p - np.array(self.translation)),
            rotation.multiply(q_back, q),
        )

    def _turn(self) -> NDArray[np.float64]:
        return np.array([math.cos(0.5 * self.yaw), 0.0, 0.0, math.sin(0.5 * self.yaw)])
