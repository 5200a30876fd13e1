"""Joint angles as anatomists and OpenSim name them: flexion, adduction, rotation.

Every moving bone has a frame as the International Society of Biomechanics recommends
(Wu et al. 2002, 2005): x forward, y up, z to the right, in the anatomical position (see
`localreg.motion.postures.standing`), where all angles are zero. A joint turns its bone by

    R = Rz(first) Rx(second) Ry(third)

against its parent (Grood and Suntay 1983): flexion about the parent's z, rotation about the
bone's own y, adduction about the axis between. Signs are such that flexion, adduction and
inward rotation are positive on both sides; for the trunk, neck and head extension, bending
to the right and turning to the left; for the collar bones lowering counts negative. The
shoulder follows the same order, as OpenSim's full-body models do, not ISB's y-x-y. The names
are those of such models where they have them (Rajagopal et al. 2016). The pelvis turns
against the ground in the same order, and moves in metres.

All three angles of a joint are given, also of those that the canonical skeleton lets turn
about fewer axes: what its hinges do is then seen from the anatomical axes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES, BONE_NAMES, BONES, DOF_COUNT
from localreg.body.subject import Subject
from localreg.motion.body_poses import PARENTS
from localreg.motion.formats.axes import (
    positions_from_y_up,
    positions_to_y_up,
    quaternions_from_y_up,
    rotations_to_y_up,
)
from localreg.motion.joint_angles import bone_rotations, continuous_zyx, joint_angles
from localreg.motion.postures import standing

FORWARD_UP_RIGHT: Final = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Turns root axes (x left, y up, z forward) into anatomical ones (x forward, y up, z right)."""

PELVIS: Final = ("pelvis_tilt", "pelvis_list", "pelvis_rotation")
"""The pelvis' turns against the ground about z, x and y."""

PELVIS_PLACE: Final = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
"""The pelvis' place on the ground: forward, up, right [m]."""

_MIDDLE: Final = {
    "lowerback": "lumbar", "upperback": "thoracolumbar", "thorax": "thoracic",
    "lowerneck": "neck", "upperneck": "upper_neck", "head": "head",
}  # fmt: skip

# Names of the turns about z, x, y, each with the sign on the right side; turns about x and y
# change it on the left.
_PAIRED: Final = {
    "femur": (("hip_flexion", 1), ("hip_adduction", 1), ("hip_rotation", 1)),
    "tibia": (("knee_angle", -1), ("knee_adduction", 1), ("knee_rotation", 1)),
    "foot": (("ankle_angle", 1), ("ankle_adduction", 1), ("ankle_rotation", 1)),
    "toes": (("mtp_angle", 1), ("mtp_adduction", 1), ("mtp_rotation", 1)),
    "clavicle": (("clav_rotation", 1), ("clav_elevation", -1), ("clav_protraction", 1)),
    "humerus": (("arm_flex", 1), ("arm_add", 1), ("arm_rot", 1)),
    "radius": (("elbow_flex", 1), ("elbow_add", 1), ("elbow_rot", 1)),
    "wrist": (("forearm_flex", 1), ("forearm_add", 1), ("pro_sup", 1)),
    "hand": (("wrist_flex", 1), ("wrist_dev", 1), ("wrist_rot", 1)),
    "fingers": (("fingers_flex", 1), ("fingers_add", 1), ("fingers_rot", 1)),
    "thumb": (("thumb_flex", 1), ("thumb_add", 1), ("thumb_rot", 1)),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Joint:
    """The three angles of a bone against its parent.

    Attributes:
        bone: the bone that they turn.
        names: of the turns about z, x and y.
        signs: +1 or -1, by which a right-handed turn counts as positive.
    """

    bone: str
    names: tuple[str, str, str]
    signs: tuple[int, int, int]


def _joint(bone: str) -> Joint:
    if bone in _MIDDLE:
        stem = _MIDDLE[bone]
        return Joint(bone, (f"{stem}_extension", f"{stem}_bending", f"{stem}_rotation"), (1, 1, 1))
    side = bone[0]
    (first, a), (second, b), (third, c) = _PAIRED[bone[1:]]
    other = 1 if side == "r" else -1
    return Joint(
        bone, (f"{first}_{side}", f"{second}_{side}", f"{third}_{side}"), (a, b * other, c * other)
    )


JOINTS: Final = tuple(_joint(bone.name) for bone in BONES if bone.dofs)
"""All joints that move, in the order of the bones."""

COORDINATES: Final = (
    *PELVIS, *PELVIS_PLACE, *(name for joint in JOINTS for name in joint.names),
)  # fmt: skip
"""Names of all coordinates: six of the pelvis, then three of every joint."""

LENGTHS: Final = frozenset(PELVIS_PLACE)
"""The coordinates that are lengths [m]; all others are angles."""


def coordinates(
    qpos: Float[ndarray, "frames 63"], subject: Subject
) -> Float[ndarray, "frames coordinates"]:
    """All `COORDINATES` of poses, angles continuous in time [rad, m]."""
    postures = FORWARD_UP_RIGHT @ standing(subject)
    turns = bone_rotations(qpos[:, 7:], subject.axis_frames)
    root = rotations_to_y_up(qpos[:, 3:7]).as_matrix()
    columns = [
        _continuous_zxy(FORWARD_UP_RIGHT @ root @ postures[0].T),
        positions_to_y_up(qpos[:, :3]) @ FORWARD_UP_RIGHT.T,
    ]
    for joint in JOINTS:
        index = BONE_NAMES.index(joint.bone)
        turn = postures[PARENTS[index]] @ turns[:, index] @ postures[index + 1].T
        columns.append(_continuous_zxy(turn) * joint.signs)
    return np.hstack(columns)


def poses(
    values: Mapping[str, Float[ndarray, " frames"]], subject: Subject
) -> Float[ndarray, "frames 63"]:
    """The poses that have these coordinates, or as near as the bones' hinges can.

    Args:
        values: coordinates by name [rad, m]; those that are not given are zero.
        subject: whose bones.
    """
    frames = len(next(iter(values.values())))
    zero = np.zeros(frames)
    postures = FORWARD_UP_RIGHT @ standing(subject)

    def turn(names: tuple[str, ...], signs: tuple[int, ...]) -> Float[ndarray, "frames 3 3"]:
        angles = np.stack([values.get(name, zero) for name in names], axis=1) * signs
        return Rotation.from_euler("ZXY", angles).as_matrix()

    turns = np.tile(np.eye(3), (frames, len(BONES), 1, 1))
    for joint in JOINTS:
        index = BONE_NAMES.index(joint.bone)
        own = turn(joint.names, joint.signs)
        turns[:, index] = postures[PARENTS[index]].T @ own @ postures[index + 1]
    place = np.stack([values.get(name, zero) for name in PELVIS_PLACE], axis=1)
    root = FORWARD_UP_RIGHT.T @ turn(PELVIS, (1, 1, 1)) @ postures[0]
    qpos = np.empty((frames, 7 + DOF_COUNT))
    qpos[:, :3] = positions_from_y_up(place @ FORWARD_UP_RIGHT)
    qpos[:, 3:7] = quaternions_from_y_up(Rotation.from_matrix(root))
    qpos[:, 7:] = joint_angles(turns, subject.axis_frames)[0]
    return qpos


def body_offset(subject: Subject, body: int) -> Float[ndarray, "3"]:
    """From the start of a body of `BODY_NAMES` to its end, in its anatomical frame [m]."""
    if BODY_NAMES[body] == "root":
        return np.zeros(3)
    return FORWARD_UP_RIGHT @ standing(subject)[body] @ subject.offsets[body - 1]


def _continuous_zxy(rotations: Float[ndarray, "frames 3 3"]) -> Float[ndarray, "frames 3"]:
    """Angles (z, x, y) with R = Rz Rx Ry, continuous in time [rad].

    Exchanging x and y mirrors space, which turns Rz(a) Rx(b) Ry(c) into
    Rz(-a) Ry(-b) Rx(-c).
    """
    swapped = rotations[:, [1, 0, 2]][:, :, [1, 0, 2]]
    return -continuous_zyx(swapped)
