"""People who do not exist: bodies, where their trackers sit, and how well they hold poses.

A person errs in every joint, but feet that stay where they are stay: errors are drawn
freely, and the pose is then moved, joint by joint in proportion to the joint's error, until
the ankles are back (Matheron's rule for conditional draws).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from calibration.eigen_skeleton import subject_of
from calibration.holds import Hold
from calibration.model import feet_of
from calibration.poses import TargetPose
from localreg.body.kinematics import Kinematics, integrate
from localreg.body.skeleton import BODY_NAMES, DOF_COUNT
from localreg.body.subject import Mount, Subject
from localreg.evaluation.body_points import BodyPoints
from sensors.pose import TrackerFrame

_ROOT_SPREAD = np.array([0.05] * 3 + [np.radians(3.0)] * 3)


@dataclass(frozen=True, slots=True)
class Habits:
    """How a person, their straps and their trackers behave.

    Attributes:
        pose_error: error of a joint about each axis [rad].
        plant_error: how far the ankle of a standing foot is off, on each axis [m].
        mount_spread: how far trackers sit from the ends of their bones, on each axis [m].
        noise_position: of a tracker on each axis [m].
        noise_orientation: about each axis [rad].
        frames: of a hold.
    """

    pose_error: float = float(np.radians(5.0 / np.sqrt(3.0)))
    plant_error: float = 0.004
    mount_spread: float = 0.03
    noise_position: float = 0.003
    noise_orientation: float = float(np.radians(0.5))
    frames: int = 80


def random_person(
    lengths: Float[ndarray, "18"], trackers: Sequence[Mount], spread: float, rng: Any
) -> Subject:
    """A person with trackers near the ends of their bones, turned anyhow.

    Args:
        lengths: of the groups [m].
        trackers: which tracker on which bone.
        spread: how far from the bone's end, on each axis [m].
        rng: NumPy's generator.
    """
    return with_random_mounts(subject_of("simulated", lengths), trackers, spread, rng)


def with_random_mounts(
    person: Subject, trackers: Sequence[Mount], spread: float, rng: Any
) -> Subject:
    """A person who has strapped the trackers on; arguments as for `random_person`."""
    ends = np.vstack([np.zeros(3), person.offsets])
    mounts = tuple(
        Mount(
            mount.tracker,
            mount.bone,
            tuple((ends[BODY_NAMES.index(mount.bone)] + rng.normal(0.0, spread, 3)).tolist()),
            tuple(Rotation.random(rng=rng).as_quat(scalar_first=True).tolist()),
        )
        for mount in trackers
    )
    return replace(person, mounts=mounts)


def perform(
    person: Subject,
    poses: Sequence[TargetPose],
    habits: Habits,
    rng: Any,
    place_seed: int | None = None,
) -> Float[ndarray, "N 63"]:
    """The poses as the person really holds them, somewhere in the room.

    Args:
        person: whose body.
        poses: what is asked for; those that are planted keep the feet of the first.
        habits: errors.
        rng: NumPy's generator.
        place_seed: of where in the room and on which spots the person stands, if that is to
            be the same whatever the errors are.
    """
    body = Kinematics.from_subject(person)
    where = rng if place_seed is None else np.random.default_rng(place_seed)
    heading = Rotation.from_euler("z", where.uniform(-np.pi, np.pi))
    place = np.array([*where.uniform(-0.5, 0.5, 2), 0.0])
    spots: Float[ndarray, "2 3"] | None = None
    if place_seed is not None:
        qpos = poses[0].qpos(0.95)
        qpos[:3] = heading.apply(qpos[:3]) + place
        root = heading * Rotation.from_quat(qpos[3:7], scalar_first=True)
        qpos[3:7] = root.as_quat(scalar_first=True)
        spots = np.asarray(_ankles(body, jnp.asarray(qpos))[0])
    done = np.zeros((len(poses), 63))
    for row, pose in zip(done, poses, strict=True):
        qpos = pose.qpos(0.95)
        qpos[:3] = heading.apply(qpos[:3]) + place
        tilt = Rotation.from_rotvec(rng.normal(0.0, habits.pose_error, 3))
        root = heading * Rotation.from_quat(qpos[3:7], scalar_first=True) * tilt
        qpos[3:7] = root.as_quat(scalar_first=True)
        qpos[7:] += rng.normal(0.0, habits.pose_error, DOF_COUNT)
        ankles = np.asarray(_ankles(body, jnp.asarray(qpos))[0])
        if spots is None:
            spots = ankles
        feet = np.array(pose.planted)
        if feet.any():
            goal = spots + rng.normal(0.0, habits.plant_error, (2, 3))
            qpos = _stand(body, qpos, goal, feet, habits)
        row[:] = qpos
    return done


def hold_frames(
    person: Subject, qpos: Float[ndarray, "63"], habits: Habits, rng: Any
) -> list[TrackerFrame]:
    """What the trackers say while a pose is held."""
    truth = BodyPoints(person).tracker_poses(qpos[None])
    J, n = len(person.trackers), habits.frames
    positions = truth.positions[0] + rng.normal(0.0, habits.noise_position, (n, J, 3))
    turn = Rotation.from_rotvec(rng.normal(0.0, habits.noise_orientation, (n * J, 3)))
    still = Rotation.from_quat(np.tile(truth.quaternions[0], (n, 1)), scalar_first=True)
    quaternions = (still * turn).as_quat(scalar_first=True).reshape(n, J, 4)
    seen = np.ones(J, bool)
    return [TrackerFrame(i / 40.0, positions[i], quaternions[i], seen, seen) for i in range(n)]


def held(
    person: Subject,
    poses: Sequence[TargetPose],
    qpos: Float[ndarray, "N 63"],
    habits: Habits,
    rng: Any,
) -> list[Hold]:
    """The statistics of all holds."""
    return [
        Hold.of_frames(pose.name, hold_frames(person, row, habits, rng))
        for pose, row in zip(poses, qpos, strict=True)
    ]


@eqx.filter_jit
def _ankles(
    body: Kinematics, qpos: Float[Array, "63"]
) -> tuple[Float[Array, "2 3"], Float[Array, "2 3 62"]]:
    poses, jacobian = body.jacobian(qpos, feet_of(body.ends))
    return poses.positions, jacobian[:, :3]


_integrate = jax.jit(integrate)


def _stand(
    body: Kinematics,
    qpos: Float[ndarray, "63"],
    goal: Float[ndarray, "2 3"],
    feet: Any,
    habits: Habits,
) -> Float[ndarray, "63"]:
    """The nearest pose with the ankles where they should be."""
    spread = np.concatenate([_ROOT_SPREAD, np.full(DOF_COUNT, max(habits.pose_error, 1e-9))])
    moved = np.zeros(62)
    at = qpos
    for _ in range(6):
        ankles, jacobian = (np.asarray(a) for a in _ankles(body, jnp.asarray(at)))
        J = jacobian[feet].reshape(-1, 62)
        away = (ankles - goal)[feet].ravel() - J @ moved
        weighted = J * spread**2
        inner = weighted @ J.T + 1e-12 * np.eye(len(J))
        moved = -weighted.T @ np.linalg.solve(inner, away)
        at = np.array(_integrate(jnp.asarray(qpos), jnp.asarray(moved)))
    return at
