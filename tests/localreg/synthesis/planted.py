"""Problems with known answers: a body in a pose, and what its trackers say of it."""

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.chain import chain_of
from localreg.body.kinematics import Kinematics
from localreg.body.subject import canonical_subject
from localreg.evaluation.body_points import BodyPoints
from localreg.synthesis.belief import Belief
from localreg.synthesis.compiled import Control
from localreg.synthesis.energy import Term, TrackerTerm
from localreg.synthesis.observation import Observation
from localreg.synthesis.solver import Problem
from localreg.synthesis.term_belief import terms_of_belief

SUBJECT = canonical_subject()
BODY, CHAIN = BodyPoints(SUBJECT), chain_of(SUBJECT)
UPRIGHT = Rotation.from_quat([0.5**0.5, 0.5**0.5, 0.0, 0.0], scalar_first=True)
ALL = np.ones(6, dtype=bool)
NONE = np.zeros(6, dtype=bool)


def standing_pose(seed: int, spread: float = 0.3) -> ndarray:
    """Somewhere, upright within half a radian, any heading, bent joints."""
    rng = np.random.default_rng(seed)
    heading = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    tilt = Rotation.from_rotvec(0.3 * rng.normal(size=3))
    root = (heading * tilt * UPRIGHT).as_quat(scalar_first=True)
    return np.concatenate([rng.normal(size=3), root, spread * rng.normal(size=56)])


def observe(
    qpos: ndarray, position_mask: ndarray = ALL, orientation_mask: ndarray = ALL
) -> Observation:
    """What the six trackers say in a pose, without noise; nonsense where masked."""
    poses = BODY.tracker_poses(np.asarray(qpos, dtype=float)[None])
    return Observation(
        np.where(position_mask[:, None], poses.positions[0], 0.0),
        np.where(orientation_mask[:, None], poses.quaternions[0], [1.0, 0.0, 0.0, 0.0]),
        position_mask,
        orientation_mask,
    )


def planted(observation: Observation, belief: Belief, c: float = 9.0) -> Problem:
    """Trackers of the default quality, and a prior."""
    control = Control(0.005, float(np.radians(1.0)), np.full((len(ALL), 2), c))
    return Problem(CHAIN, observation, control, belief)


def belief_about(angles: ndarray, sigma: float) -> Belief:
    """A prior over joint angles that knows nothing of the root."""
    information = np.zeros((62, 62))
    information[6:, 6:] = np.eye(56) / sigma**2
    qpos = np.concatenate([np.zeros(3), UPRIGHT.as_quat(scalar_first=True), angles])
    return Belief(qpos, np.zeros(62), information)


def terms_of(problem: Problem) -> tuple[Term, ...]:
    """The problem as the papers' energy terms."""
    observation = jax.tree.map(jnp.asarray, problem.observation)
    control = (jnp.asarray(part) for part in problem.control)
    body = Kinematics.from_chain(problem.chain)
    return TrackerTerm(body, observation, *control), *terms_of_belief(problem.belief)


def turned_about_vertical(qpos: ndarray, angle: float) -> ndarray:
    """The body turned by an angle about the vertical through its root."""
    turn = Rotation.from_rotvec([0.0, 0.0, angle])
    root = turn * Rotation.from_quat(qpos[3:7], scalar_first=True)
    return np.concatenate([qpos[:3], root.as_quat(scalar_first=True), qpos[7:]])


def bone_end_error(one: ndarray, other: ndarray) -> float:
    """Mean distance of bone ends [m]."""
    ends = BODY.bone_ends(np.stack([np.asarray(one, dtype=float), np.asarray(other, dtype=float)]))
    return float(np.linalg.norm(ends[0] - ends[1], axis=1).mean())
