"""From the tracker's reference frame to the world.

IS-900: x north, y east, z down. World: x, y horizontal, z up. Both are right-handed, so
half a turn about the common x axis relates them: S = diag(1, -1, -1) and

    p_world = S p_ned = (n, -e, -d)        R_world = S R_ned S^T.

Multiplying by S on both sides also relabels the body axes in the same way: a tracker whose
case axes are forward, right, down becomes one with forward, left, up, and a tracker that
reports no rotation has its axes along the world's. For a quaternion that is
(w, x, -y, -z). S is its own inverse, so the same function goes either way.
"""

import numpy as np
from numpy.typing import NDArray

_S = np.array([1.0, -1.0, -1.0])
_S_QUATERNION = np.array([1.0, 1.0, -1.0, -1.0])


def flip_position(p: NDArray[np.float64]) -> NDArray[np.float64]:
    """North-east-down to world or back, shape (..., 3) [m]."""
    return p * _S


def flip_quaternion(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """North-east-down to world or back, w x y z, shape (..., 4)."""
    return q * _S_QUATERNION
