"""Rotations in JAX: quaternions w x y z, and the exponential map with its derivatives.

Every function works on the last axis and broadcasts over the others. Series replace the
quotients near zero inside a double `where`, so that values and derivatives are smooth
there. Source of the Jacobians: Sola, "A micro Lie theory for state estimation in
robotics", 2018, equations 143 to 146.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

_SMALL = 1e-4  # below this angle [rad] the series are exact to double precision


def multiply(a: Float[Array, "*#b 4"], b: Float[Array, "*#b 4"]) -> Float[Array, "*b 4"]:
    """Hamilton product a b: the rotation b, then a."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    return jnp.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(q: Float[Array, "*b 4"]) -> Float[Array, "*b 4"]:
    """The inverse of a unit quaternion."""
    return q * jnp.array([1.0, -1.0, -1.0, -1.0], dtype=q.dtype)


def cross(a: Float[Array, "*#b 3"], b: Float[Array, "*#b 3"]) -> Float[Array, "*b 3"]:
    """Cross product, written out: XLA fuses it, where `jnp.cross` gathers."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return jnp.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def rotate(q: Float[Array, "*#b 4"], v: Float[Array, "*#b 3"]) -> Float[Array, "*b 3"]:
    """The vector v turned by the unit quaternion q."""
    w, u = q[..., :1], q[..., 1:]
    t = 2.0 * cross(u, v)
    return v + w * t + cross(u, t)


def to_matrix(q: Float[Array, "*b 4"]) -> Float[Array, "*b 3 3"]:
    """The rotation matrix of a unit quaternion."""
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def from_matrix(R: Float[Array, "3 3"]) -> Float[Array, " 4"]:
    """The unit quaternion of a rotation matrix, by its largest eigenvector (Bar-Itzhack 2000)."""
    xx, yy, zz = R[0, 0], R[1, 1], R[2, 2]
    a, b, c = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    d, e, f = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    rows = [
        [xx + yy + zz, a, b, c],
        [a, xx - yy - zz, d, e],
        [b, d, yy - xx - zz, f],
        [c, e, f, zz - xx - yy],
    ]
    return jnp.linalg.eigh(jnp.stack([jnp.stack(row) for row in rows]))[1][:, -1]


def exp(v: Float[Array, "*b 3"]) -> Float[Array, "*b 4"]:
    """The unit quaternion of a rotation vector [rad]."""
    squared = jnp.sum(v * v, axis=-1, keepdims=True)
    small = squared < _SMALL**2
    angle = jnp.sqrt(jnp.where(small, 1.0, squared))
    half_sinc = jnp.where(small, 0.5 - squared / 48.0, jnp.sin(0.5 * angle) / angle)
    cosine = jnp.where(small, 1.0 - squared / 8.0, jnp.cos(0.5 * angle))
    return jnp.concatenate([cosine, half_sinc * v], axis=-1)


def log(q: Float[Array, "*b 4"]) -> Float[Array, "*b 3"]:
    """The rotation vector [rad], at most pi long, of a unit quaternion.

    q and -q give the same vector. At half a turn, where the vector jumps to its
    opposite, both value and derivative stay finite.
    """
    q = jnp.where(q[..., :1] < 0.0, -q, q)
    w, u = q[..., :1], q[..., 1:]
    squared = jnp.sum(u * u, axis=-1, keepdims=True)
    small = squared < _SMALL**2
    sine = jnp.sqrt(jnp.where(small, 1.0, squared))
    safe_w = jnp.where(small, jnp.maximum(w, 0.5), 1.0)
    ratio = jnp.where(
        small,
        2.0 / safe_w - 2.0 * squared / (3.0 * safe_w**3),
        2.0 * jnp.arctan2(sine, w) / sine,
    )
    return ratio * u


def hinge(axis: Float[Array, "*b 3"], angle: Float[Array, "*b"]) -> Float[Array, "*b 4"]:
    """The unit quaternion that turns by an angle [rad] about a unit axis."""
    half = 0.5 * angle
    return jnp.concatenate([jnp.cos(half)[..., None], jnp.sin(half)[..., None] * axis], axis=-1)


def skew(v: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """The matrix [v]x with [v]x u = v x u."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    o = jnp.zeros_like(x)
    rows = [[o, -z, y], [z, o, -x], [-y, x, o]]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def right_jacobian(v: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """J with exp(v + d) = exp(v) exp(J d) to first order in d."""
    squared = jnp.sum(v * v, axis=-1)[..., None, None]
    small = squared < _SMALL**2
    safe = jnp.where(small, 1.0, squared)
    angle = jnp.sqrt(safe)
    a = jnp.where(small, 0.5 - squared / 24.0, (1.0 - jnp.cos(angle)) / safe)
    b = jnp.where(small, 1.0 / 6.0 - squared / 120.0, (angle - jnp.sin(angle)) / (safe * angle))
    K = skew(v)
    return jnp.eye(3, dtype=v.dtype) - a * K + b * _square(K)


def inverse_left_jacobian(v: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """J with log(exp(d) exp(v)) = v + J d to first order in d; finite up to |v| = pi."""
    squared = jnp.sum(v * v, axis=-1)[..., None, None]
    small = squared < _SMALL**2
    safe = jnp.where(small, 1.0, squared)
    half = 0.5 * jnp.sqrt(safe)
    # (1 + cos t) / (2 t sin t) = cot(t/2) / (2 t), which has no pole at t = pi.
    b = jnp.where(small, 1.0 / 12.0, 1.0 / safe - jnp.cos(half) / (4.0 * half * jnp.sin(half)))
    K = skew(v)
    return jnp.eye(3, dtype=v.dtype) - 0.5 * K + b * _square(K)


def _square(K: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3 3"]:
    """K K by broadcasting, which XLA fuses; a batched 3 x 3 dot it does not."""
    return jnp.sum(K[..., :, :, None] * K[..., None, :, :], axis=-2)
