"""Unit quaternions, w x y z, in plain NumPy.

All functions broadcast over leading axes. A quaternion turns body axes into reference axes
(active rotation): `rotate(q, v_body)` is the vector in the reference frame.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

IDENTITY: Array = np.array([1.0, 0.0, 0.0, 0.0])
IDENTITY.flags.writeable = False

# Below this angle [rad] sin(x)/x is 1 to the last bit that matters and dividing by
# sin(angle) would lose digits.
_SMALL_ANGLE = 1e-6


def normalize(q: Array) -> Array:
    """Scale to unit length; a zero quaternion gives NaN, callers reject those before."""
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def conjugate(q: Array) -> Array:
    """The inverse rotation of a unit quaternion, shape (..., 4)."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def multiply(a: Array, b: Array) -> Array:
    """Hamilton product: first rotate by `b`, then by `a`; shapes (..., 4)."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def rotate(q: Array, v: Array) -> Array:
    """Turn vectors (..., 3) by unit quaternions (..., 4)."""
    # Written out: np.cross costs 20 us a call, too much on the way of every sample.
    w, x, y, z = np.moveaxis(q, -1, 0)
    a, b, c = np.moveaxis(v, -1, 0)
    ta, tb, tc = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return np.stack(
        [
            a + w * ta + y * tc - z * tb,
            b + w * tb + z * ta - x * tc,
            c + w * tc + x * tb - y * ta,
        ],
        axis=-1,
    )


def from_rotation_vector(v: Array) -> Array:
    """Quaternion of a rotation vector (axis times angle), shape (..., 3) [rad]."""
    half = 0.5 * np.linalg.norm(v, axis=-1, keepdims=True)
    # np.sinc is sin(pi x)/(pi x): finite at zero.
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * v], axis=-1)


def from_euler(ypr: Array) -> Array:
    """Quaternion of Rz(yaw) Ry(pitch) Rx(roll).

    Args:
        ypr: yaw, pitch, roll, shape (..., 3) [rad].

    Returns:
        Unit quaternions, shape (..., 4).
    """
    c = np.moveaxis(np.cos(0.5 * ypr), -1, 0)
    s = np.moveaxis(np.sin(0.5 * ypr), -1, 0)
    (cy, cp, cr), (sy, sp, sr) = c, s
    return np.stack(
        [
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        ],
        axis=-1,
    )


def to_euler(q: Array) -> Array:
    """Yaw, pitch, roll [rad] with R = Rz(yaw) Ry(pitch) Rx(roll), shape (..., 3)."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return np.stack([yaw, pitch, roll], axis=-1)


def to_matrix(q: Array) -> Array:
    """Rotation matrices, shape (..., 3, 3); columns are the body axes."""
    columns = [rotate(q, axis) for axis in np.eye(3)]
    return np.stack(columns, axis=-1)


def from_matrix(R: Array) -> Array:
    """Unit quaternion of one rotation matrix, shape (3, 3), by its largest component.

    Taking the largest of |w|, |x|, |y|, |z| as divisor keeps all digits for every
    rotation, half turns included (Shepperd, J. Guidance and Control 1(3), 1978).
    """
    trace = float(np.trace(R))
    squares = np.array([trace, R[0, 0], R[1, 1], R[2, 2]])
    i = int(np.argmax(squares))
    if i == 0:
        q = np.array([1.0 + trace, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    else:
        a, b, c = (i - 1) % 3, i % 3, (i + 1) % 3
        q = np.empty(4)
        q[0] = R[c, b] - R[b, c]
        q[1 + a] = 1.0 + R[a, a] - R[b, b] - R[c, c]
        q[1 + b] = R[b, a] + R[a, b]
        q[1 + c] = R[c, a] + R[a, c]
    return normalize(q)


def slerp(a: Array, b: Array, fraction: Array) -> Array:
    """Constant-speed rotation from `a` (fraction 0) to `b` (1) along the short way.

    Fractions outside 0..1 extrapolate at the same speed (Shoemake, SIGGRAPH 1985).

    Args:
        a: unit quaternions, shape (..., 4).
        b: unit quaternions, shape (..., 4).
        fraction: shape (...).

    Returns:
        Unit quaternions, shape (..., 4).
    """
    dot = np.sum(a * b, axis=-1, keepdims=True)
    b = np.where(dot < 0.0, -b, b)
    # The angle from chord lengths: arccos(dot) has no digits left near identical rotations.
    angle = 2.0 * np.arctan2(
        np.linalg.norm(b - a, axis=-1, keepdims=True), np.linalg.norm(b + a, axis=-1, keepdims=True)
    )
    f = np.asarray(fraction)[..., None]
    small = angle < _SMALL_ANGLE
    sine = np.where(small, 1.0, np.sin(angle))
    wa = np.where(small, 1.0 - f, np.sin((1.0 - f) * angle) / sine)
    wb = np.where(small, f, np.sin(f * angle) / sine)
    return normalize(wa * a + wb * b)


def angle_between(a: Array, b: Array) -> Array:
    """Angle of the rotation that takes `a` to `b`, 0..pi [rad], shape (...)."""
    dot = np.sum(a * b, axis=-1, keepdims=True)
    b = np.where(dot < 0.0, -b, b)
    half = np.arctan2(np.linalg.norm(b - a, axis=-1), np.linalg.norm(b + a, axis=-1))
    return np.asarray(4.0 * half)
