"""How much a set of poses can tell, before anybody has held one.

The information matrix of lengths, mounts and feet is the sum over poses of what each tells
once its own unknowns (root, errors of the joints) are eliminated, plus what is believed
beforehand. Its inverse bounds the covariance of every estimate (Cramer and Rao; with
beliefs, van Trees), and the fit's posterior is that bound at the estimate.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from calibration.anthropometry import GROUP_COUNT
from calibration.eigen_skeleton import SkeletonPrior, average_subject
from calibration.fit import FitSettings, default_mounts
from calibration.model import Beliefs, CalibrationModel, Holds, Problem, Start
from calibration.poses import TargetPose
from calibration.result import nine_deviations
from calibration.solver import linearize_at, pose_information
from localreg.body.subject import Mount, canonical_subject

POSITION_SD = 6e-4
ORIENTATION_SD = float(np.radians(0.075))
"""What the mean of a hold is known to: 80 frames of 3 mm and 0.5 deg, and skin."""


def information(
    poses: Sequence[TargetPose],
    prior: SkeletonPrior,
    *,
    settings: FitSettings | None = None,
    trackers: Sequence[Mount] | None = None,
    position_sd: float = POSITION_SD,
    orientation_sd: float = ORIENTATION_SD,
) -> tuple[Float[ndarray, "N s s"], Float[ndarray, "s s"]]:
    """What each pose tells the average person, and what is believed beforehand.

    Args:
        poses: to be held.
        prior: the eigen-skeleton.
        settings: beliefs, the errors of poses among them.
        trackers: which tracker on which bone; the six default ones if none are given.
        position_sd: of the mean position of a hold on each axis [m].
        orientation_sd: of its mean orientation about each axis [rad].

    Returns:
        Information matrices of the shared unknowns in the units of `model`.
    """
    settings = settings or FitSettings()
    average = average_subject(prior)
    worn = trackers or canonical_subject().mounts
    model = CalibrationModel.of(replace(average, mounts=default_mounts(average, worn)))
    N, J = len(poses), len(worn)
    none = np.tile([1.0, 0.0, 0.0, 0.0], (N, J, 1))
    planted = np.array([pose.planted for pose in poses], dtype=float)
    holds = Holds(
        positions=jnp.zeros((N, J, 3)),
        quaternions=jnp.asarray(none),
        position_whiteners=jnp.broadcast_to(jnp.eye(3) / position_sd, (N, J, 3, 3)),
        orientation_whiteners=jnp.broadcast_to(jnp.eye(3) / orientation_sd, (N, J, 3, 3)),
        position_weights=jnp.ones((N, J)),
        orientation_weights=jnp.ones((N, J)),
        targets=jnp.asarray(np.array([pose.angles for pose in poses])),
        planted=jnp.asarray(planted),
    )
    beliefs = Beliefs(
        jnp.asarray(prior.mean),
        jnp.asarray(np.linalg.cholesky(prior.covariance)),
        jnp.asarray(settings.mount_sigma),
        jnp.asarray(settings.pose_sigma),
        jnp.asarray(settings.plant_sigma),
    )
    roots = np.array([pose.qpos()[:7] for pose in poses])
    start = Start(jnp.asarray(roots), jnp.asarray(none[0]), jnp.zeros((2, 3)))
    problem = Problem(model, holds, beliefs, start)
    unknowns = jnp.zeros(model.shared_size + N * model.local_size)
    linear = linearize_at(problem, unknowns)
    believed = np.asarray(linear.shared_jacobian)
    told = pose_information(np.asarray(linear.by_shared), np.asarray(linear.by_local))
    return told, believed.T @ believed


def expected_deviations(
    information_matrix: Float[ndarray, "s s"], prior: SkeletonPrior
) -> Float[ndarray, "9"]:
    """Relative standard deviations of the nine lengths that an information allows."""
    covariance = np.linalg.inv(information_matrix)[:GROUP_COUNT, :GROUP_COUNT]
    L = np.linalg.cholesky(prior.covariance)
    return nine_deviations(prior.lengths, L @ covariance @ L.T)


def length_information(
    information_matrix: Float[ndarray, "s s"], prior: SkeletonPrior
) -> Float[ndarray, "18 18"]:
    """Information of the logarithms of the lengths, everything else unknown (Schur)."""
    inner = np.linalg.inv(information_matrix[GROUP_COUNT:, GROUP_COUNT:])
    cross = information_matrix[:GROUP_COUNT, GROUP_COUNT:]
    whitened = information_matrix[:GROUP_COUNT, :GROUP_COUNT] - cross @ inner @ cross.T
    inverse_root = np.linalg.inv(np.linalg.cholesky(prior.covariance))
    return inverse_root.T @ whitened @ inverse_root
