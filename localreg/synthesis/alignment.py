"""Placing a whole body rigidly where the trackers are."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray

from localreg.body.chain import Chain, blank_placed, place, rotate
from localreg.database.features import rotation_matrix
from localreg.synthesis.observation import Observation

_POSITION_SCALE = 0.05  # a body placed rigidly fits positions to about this [m] ...
_ORIENTATION_SCALE = 0.3  # ... and orientations to about this [rad]
_FALLBACK_SHARE = 1e-3


def align_root(
    chain: Chain,
    fallback: Float[ndarray, "63"],
    angles: Float[ndarray, "56"],
    observation: Observation,
) -> Float[ndarray, "63"]:
    """The pose with given joint angles whose root fits the measured trackers best.

    Wahba's problem over tracker orientations and positions about their centroid, solved by
    Davenport's q-method (Markley and Mortari 2000). What no tracker tells is taken from the
    fallback's root.
    """
    qpos = np.concatenate([np.zeros(3), [1.0, 0.0, 0.0, 0.0], angles])
    _align(chain, np.asarray(fallback, dtype=float), observation, qpos)
    return qpos


@njit(cache=True)
@no_type_check
def _align(chain, fallback, observation, qpos):
    """Write the root of a pose that stands upright at the origin."""
    placed = blank_placed(chain)
    place(chain, qpos, placed)
    seen, facing = observation.position_mask, observation.orientation_mask
    one, other, profile = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    rotation_matrix(fallback[3:7], profile)
    profile *= _FALLBACK_SHARE
    measured_center, center, count = np.zeros(3), np.zeros(3), np.sum(seen)
    for j in range(len(seen)):
        if seen[j]:
            measured_center += observation.positions[j] / count
            center += placed.site_position[j] / count
    for j in range(len(seen)):
        if seen[j]:
            measured = (observation.positions[j] - measured_center) / _POSITION_SCALE
            expected = (placed.site_position[j] - center) / _POSITION_SCALE
            profile += np.outer(measured, expected)
        if facing[j]:
            rotation_matrix(observation.quaternions[j], one)
            rotation_matrix(placed.site_orientation[j], other)
            profile += np.dot(one, other.T) / _ORIENTATION_SCALE**2
    # The best rotation is the eigenvector of the greatest eigenvalue.
    trace = profile[0, 0] + profile[1, 1] + profile[2, 2]
    K = np.empty((4, 4))
    K[1:, 1:] = profile + profile.T - trace * np.eye(3)
    K[0, 0] = trace
    K[0, 1] = K[1, 0] = profile[2, 1] - profile[1, 2]
    K[0, 2] = K[2, 0] = profile[0, 2] - profile[2, 0]
    K[0, 3] = K[3, 0] = profile[1, 0] - profile[0, 1]
    qpos[3:7] = np.linalg.eigh(K)[1][:, 3]
    if count:
        rotate(qpos[3:7], center, qpos[:3])
        qpos[:3] = measured_center - qpos[:3]
    else:
        qpos[:3] = fallback[:3]
