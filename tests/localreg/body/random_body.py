"""Subjects and poses that nobody has, to test with."""

import numpy as np
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES, QPOS_SIZE, default_axis_frames, default_offsets
from localreg.body.subject import Mount, Subject


def random_subject(seed: int, *, trackers: int = 7, missing_bones: int = 0) -> Subject:
    """Any proportions and axis frames; trackers anywhere, turned anyhow.

    Subjects with equally many trackers wear them on the same bones, so that they share
    compiled programs.
    """
    rng = np.random.default_rng(seed)
    offsets = default_offsets() * rng.uniform(0.5, 1.5, size=(30, 1))
    offsets = Rotation.random(30, rng).apply(offsets)
    offsets[rng.choice(30, missing_bones, replace=False)] = 0.0
    frames = Rotation.random(30, rng).as_matrix() @ default_axis_frames()
    subject = Subject.from_offsets(f"random-{seed}", offsets, frames)
    carriers = np.random.default_rng(7).choice(BODY_NAMES, trackers)
    mounts = tuple(
        Mount(
            f"t{i}",
            str(carrier),
            tuple(rng.normal(scale=0.1, size=3).tolist()),
            tuple(Rotation.random(None, rng).as_quat(scalar_first=True).tolist()),
        )
        for i, carrier in enumerate(carriers)
    )
    return Subject(subject.name, subject.lengths, subject.directions, subject.axis_frames, mounts)


def random_poses(seed: int, count: int, spread: float = 1.0) -> ndarray:
    """Poses with any root and joint angles of so many radians."""
    rng = np.random.default_rng(seed)
    qpos = rng.normal(scale=spread, size=(count, QPOS_SIZE))
    qpos[:, 3:7] = Rotation.random(count, rng).as_quat(scalar_first=True)
    return qpos
