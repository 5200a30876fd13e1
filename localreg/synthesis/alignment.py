"""Placing a whole body rigidly where the trackers are."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.chain import Chain, place_trackers
from localreg.synthesis.observation import Observation

_POSITION_SCALE = 0.05  # a body placed rigidly fits positions to about this [m] ...
_ORIENTATION_SCALE = 0.3  # ... and orientations to about this [rad]


def align_root(
    chain: Chain,
    fallback: Float[ndarray, "63"],
    angles: Float[ndarray, "56"],
    observation: Observation,
) -> Float[ndarray, "63"]:
    """The pose with given joint angles whose root fits the measured trackers best.

    Wahba's problem over tracker orientations and positions about their centroid, solved
    by singular value decomposition (Markley 1988). What no tracker tells is taken from
    the fallback's root.
    """
    upright = np.concatenate([np.zeros(3), [1.0, 0.0, 0.0, 0.0], angles])
    positions, quaternions = place_trackers(chain, upright)
    seen = np.asarray(observation.position_mask)
    profile = 1e-3 * _matrices(fallback[3:7])
    measured_center = predicted_center = np.zeros(3)
    if seen.any():
        measured = np.asarray(observation.positions)[seen]
        measured_center, predicted_center = measured.mean(axis=0), positions[seen].mean(axis=0)
        arms = (measured - measured_center) / _POSITION_SCALE
        profile += arms.T @ ((positions[seen] - predicted_center) / _POSITION_SCALE)
    turned = np.asarray(observation.orientation_mask)
    if turned.any():
        facing = _matrices(np.asarray(observation.quaternions)[turned])
        expected = _matrices(quaternions[turned])
        profile += np.einsum("jac,jbc->ab", facing, expected) / _ORIENTATION_SCALE**2
    U, _, Vt = np.linalg.svd(profile)
    R = U @ (np.array([1.0, 1.0, np.linalg.det(U @ Vt)])[:, None] * Vt)
    position = measured_center - R @ predicted_center if seen.any() else fallback[:3]
    return np.concatenate([position, Rotation.from_matrix(R).as_quat(scalar_first=True), angles])


def _matrices(quaternions: Float[ndarray, "*k 4"]) -> Float[ndarray, "*k 3 3"]:
    return Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
