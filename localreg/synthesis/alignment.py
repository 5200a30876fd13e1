"""Placing a whole body rigidly where the trackers are."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from localreg import numerics as numerics
from localreg.body import rotations
from localreg.body.kinematics import Kinematics
from localreg.synthesis.energy import Observation

_POSITION_SCALE = 0.05  # a body placed rigidly fits positions to about this [m] ...
_ORIENTATION_SCALE = 0.3  # ... and orientations to about this [rad]


def align_root(
    kinematics: Kinematics,
    fallback: Float[Array, " 63"],
    angles: Float[Array, " 56"],
    observation: Observation,
) -> Float[Array, " 63"]:
    """The pose with given joint angles whose root fits the measured trackers best.

    Wahba's problem over tracker orientations and positions about their centroid, solved
    by singular value decomposition (Markley 1988). What no tracker tells is taken from
    the fallback's root.
    """
    upright = jnp.concatenate([jnp.zeros(3), jnp.array([1.0, 0.0, 0.0, 0.0]), angles])
    predicted = kinematics.tracker_poses(upright)
    weight = observation.position_mask.astype(angles.dtype)
    count = jnp.maximum(jnp.sum(weight), 1e-9)
    measured_center = weight @ observation.positions / count
    predicted_center = weight @ predicted.positions / count
    arms = (observation.positions - measured_center) * weight[:, None] / _POSITION_SCALE
    profile = arms.T @ ((predicted.positions - predicted_center) / _POSITION_SCALE)
    turned = observation.orientation_mask.astype(angles.dtype) / _ORIENTATION_SCALE**2
    profile += jnp.einsum(
        "j,jac,jbc->ab",
        turned,
        rotations.to_matrix(observation.quaternions),
        rotations.to_matrix(predicted.quaternions),
    )
    profile += 1e-3 * rotations.to_matrix(fallback[3:7])
    U, _, Vt = jnp.linalg.svd(profile)
    R = U @ (jnp.array([1.0, 1.0, jnp.linalg.det(U @ Vt)])[:, None] * Vt)
    position = jnp.where(
        jnp.any(observation.position_mask), measured_center - R @ predicted_center, fallback[:3]
    )
    return jnp.concatenate([position, rotations.from_matrix(R), angles])


def snap_to_reference(
    kinematics: Kinematics, qpos: Float[Array, " 63"], observation: Observation, reference: int
) -> Float[Array, " 63"]:
    """The pose moved rigidly so that its reference tracker is where it was measured.

    Where that tracker is masked, the pose itself.
    """
    predicted = kinematics.tracker_poses(qpos)
    turn = rotations.multiply(
        observation.quaternions[reference], rotations.conjugate(predicted.quaternions[reference])
    )
    arm = rotations.rotate(turn, qpos[:3] - predicted.positions[reference])
    root = rotations.multiply(turn, qpos[3:7])
    moved = jnp.concatenate([observation.positions[reference] + arm, root, qpos[7:]])
    known = observation.position_mask[reference] & observation.orientation_mask[reference]
    return jnp.where(known, moved, qpos)
