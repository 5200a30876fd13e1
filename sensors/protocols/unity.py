"""Unity's axes, which VMC and VRChat use: x right, y up, z forward, left-handed.

A world whose x is Unity's forward, y its left and z its up: p = (z, -x, y). The mirror in
this also turns rotations round: axis (z, -x, y), angle negated, which for quaternions
w x y z is (w, -z, x, -y).
"""

import numpy as np

from sensors import rotation
from sensors.rotation import Array


def position_to_world(p: Array) -> Array:
    """Unity x y z to the world, shape (..., 3) [m]."""
    return p[..., [2, 0, 1]] * [1.0, -1.0, 1.0]


def quaternion_to_world(q: Array) -> Array:
    """Unity w x y z to the world, shape (..., 4)."""
    return q[..., [0, 3, 1, 2]] * [1.0, -1.0, 1.0, -1.0]


def position_from_world(p: Array) -> Array:
    """World to Unity x y z, shape (..., 3) [m]."""
    return p[..., [1, 2, 0]] * [-1.0, 1.0, 1.0]


def quaternion_from_world(q: Array) -> Array:
    """World to Unity w x y z, shape (..., 4)."""
    return q[..., [0, 2, 3, 1]] * [1.0, 1.0, -1.0, -1.0]


def euler_to_quaternion(xyz: Array) -> Array:
    """Quaternion w x y z of Unity's Euler angles: first z, then x, then y.

    Args:
        xyz: angles about the three axes, shape (3,) [rad].
    """
    x, y, z = (rotation.from_rotation_vector(a * e) for a, e in zip(xyz, np.eye(3), strict=True))
    return rotation.multiply(y, rotation.multiply(x, z))


def quaternion_to_euler(q: Array) -> Array:
    """Angles about x, y, z with R = Ry Rx Rz, as Unity's inspector shows them.

    Where x is a right angle only y minus or plus z is known; z is 0 then.

    Args:
        q: w x y z, shape (..., 4).

    Returns:
        Shape (..., 3) [rad].
    """
    w, x, y, z = np.moveaxis(q, -1, 0)
    sine = np.clip(2.0 * (w * x - y * z), -1.0, 1.0)
    about_y = np.arctan2(2.0 * (x * z + w * y), 1.0 - 2.0 * (x * x + y * y))
    about_z = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z))
    locked = np.abs(sine) > 1.0 - 1e-12
    about_y = np.where(
        locked, np.arctan2(-2.0 * (x * z - w * y), 1.0 - 2.0 * (y * y + z * z)), about_y
    )
    return np.stack([np.arcsin(sine), about_y, np.where(locked, 0.0, about_z)], axis=-1)
