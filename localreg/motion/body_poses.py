"""Where the bones of many poses are, with nothing but NumPy: what file writers need.

World axes, z up, metres. MuJoCo's kinematics is what this is tested against.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES, BONES
from localreg.body.subject import Subject
from localreg.motion.joint_angles import bone_rotations

PARENTS = tuple(BODY_NAMES.index(bone.parent) for bone in BONES)
"""For every bone the index of its parent among `BODY_NAMES`."""


def body_turns(
    qpos: Float[ndarray, "frames 63"], subject: Subject
) -> Float[ndarray, "frames 31 3 3"]:
    """The turn of every body of `BODY_NAMES` from its own axes into the world's."""
    own = bone_rotations(qpos[:, 7:], subject.axis_frames)
    turns = np.empty((len(qpos), len(BODY_NAMES), 3, 3))
    turns[:, 0] = Rotation.from_quat(qpos[:, 3:7], scalar_first=True).as_matrix()
    for index, parent in enumerate(PARENTS):
        turns[:, index + 1] = turns[:, parent] @ own[:, index]
    return turns


def body_points(
    qpos: Float[ndarray, "frames 63"],
    subject: Subject,
    turns: Float[ndarray, "frames 31 3 3"] | None = None,
) -> tuple[Float[ndarray, "frames 31 3"], Float[ndarray, "frames 31 3"]]:
    """Where every body of `BODY_NAMES` starts and ends in the world [m].

    Args:
        qpos: the poses.
        subject: whose bones.
        turns: the turns of the bodies, if they are known already.

    Returns:
        The starts and the far ends; those of the root are both at its origin.
    """
    turns = body_turns(qpos, subject) if turns is None else turns
    starts = np.empty((len(qpos), len(BODY_NAMES), 3))
    ends = np.empty_like(starts)
    starts[:, 0] = ends[:, 0] = qpos[:, :3]
    for index, parent in enumerate(PARENTS):
        starts[:, index + 1] = ends[:, parent]
        ends[:, index + 1] = ends[:, parent] + turns[:, index + 1] @ subject.offsets[index]
    return starts, ends


def rest_starts(subject: Subject) -> Float[ndarray, "31 3"]:
    """Where every body of `BODY_NAMES` starts at rest, from the root, in root axes [m]."""
    starts, ends = np.zeros((2, len(BODY_NAMES), 3))
    for index, parent in enumerate(PARENTS):
        starts[index + 1] = ends[parent]
        ends[index + 1] = ends[parent] + subject.offsets[index]
    return starts
