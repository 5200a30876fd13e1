"""Random people and motions for the tests of this folder."""

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BONES, DOF_COUNT, default_offsets, joint_limits
from localreg.body.subject import Subject
from localreg.motion.motion import Motion, Provenance

# Angles at which Euler charts and quaternions are at their worst.
SPECIAL = np.array([0.0, np.pi / 2, -np.pi / 2, np.pi, -np.pi, 1e-9, np.pi / 2 - 1e-9])


def make_subject(seed, frames="canonical"):
    """A person of random bone lengths and directions; `frames` "random" turns axes too."""
    rng = np.random.default_rng(seed)
    offsets = default_offsets() * rng.uniform(0.75, 1.3, (len(BONES), 1))
    offsets = offsets + rng.normal(0.0, 0.01, offsets.shape)
    axis_frames = None
    if frames == "random":
        axis_frames = Rotation.random(len(BONES), rng=rng).as_matrix()
    return Subject.from_offsets("someone", offsets, axis_frames)


def make_motion(seed, count=5, span=3.5, special=0.0, frames="canonical", rate=120.0):
    """Random poses, unrelated from frame to frame; a share of the angles is special."""
    rng = np.random.default_rng(seed)
    qpos = np.empty((count, 7 + DOF_COUNT))
    qpos[:, :3] = rng.uniform(-5.0, 5.0, (count, 3))
    qpos[:, 3:7] = Rotation.random(count, rng=rng).as_quat(scalar_first=True)
    angles = rng.uniform(-span, span, (count, DOF_COUNT))
    is_special = rng.random(angles.shape) < special
    qpos[:, 7:] = np.where(is_special, rng.choice(SPECIAL, angles.shape), angles)
    return Motion(qpos, rate, make_subject(seed, frames), Provenance("random"))


def make_calm_motion(seed, count=40, rate=120.0):
    """A smooth motion inside the anatomical ranges."""
    rng = np.random.default_rng(seed)
    low, high = joint_limits().T
    middle, reach = (low + high) / 2, (high - low) / 2
    times = np.arange(count)[:, None] / rate
    waves = np.sin(
        2 * np.pi * rng.uniform(0.2, 1.0, DOF_COUNT) * times + rng.uniform(0, 6, DOF_COUNT)
    )
    qpos = np.empty((count, 7 + DOF_COUNT))
    qpos[:, :3] = [0.0, 0.0, 0.9] + times * rng.normal(0.0, 1.0, 3)
    heading = Rotation.from_euler("z", rng.uniform(-3, 3) + times)
    qpos[:, 3:7] = (heading * Rotation.from_euler("x", 90.0, degrees=True)).as_quat(
        scalar_first=True
    )
    qpos[:, 7:] = middle + 0.9 * reach * waves
    return Motion(qpos, rate, make_subject(seed), Provenance("calm"))


def recipes():
    """What to make random motions of: `make_motion(**recipe)`, with and without special angles.

    Motions are made in the tests, not in the strategy: the run-time type checks draw random
    numbers, which a strategy must not.
    """
    return st.fixed_dictionaries(
        {"seed": st.integers(0, 2**32 - 1), "special": st.sampled_from([0.0, 0.3])}
    )


def turn_distance(a, b):
    """Angles between rotations given as quaternions w x y z [rad]."""
    return (
        Rotation.from_quat(a, scalar_first=True).inv() * Rotation.from_quat(b, scalar_first=True)
    ).magnitude()
