"""The skeleton as other programs know it: families of joint names, each with its own tree.

A joint carries the frame of one bone and sits where the bone starts. A family may leave out
bones that never turn, hang a joint on another one whose bone starts at the same place, and
count rotations from another posture; positions of joints are the same to the last bit of
rounding. Bones for which a family has no name become joints between its own ones, which
programs that map by name pass over.

All rest frames are parallel to the root's: x left, y up, z forward.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from localreg.body.skeleton import BODY_NAMES, BONES
from localreg.body.subject import Subject
from localreg.errors import MotionError
from localreg.motion.body_poses import body_turns, rest_starts
from localreg.motion.formats.axes import positions_to_y_up, rotations_to_y_up
from localreg.motion.formats.bvh import JOINT_NAMES
from localreg.motion.postures import t_pose

FAMILIES: Final = ("cmu", "mixamo", "vrm")
"""Families of joint names: of CMU's BVH files, of Mixamo's rigs, of VRM and Unity's humans."""

_MIXAMO: Final = {
    "root": "Hips", "lowerback": "Spine", "upperback": "Spine1", "thorax": "Spine2",
    "lowerneck": "Neck", "upperneck": "Neck1", "head": "Head",
    "femur": "UpLeg", "tibia": "Leg", "foot": "Foot", "toes": "ToeBase",
    "clavicle": "Shoulder", "humerus": "Arm", "radius": "ForeArm", "wrist": "ForeArmTwist",
    "hand": "Hand", "fingers": "HandMiddle1", "thumb": "HandThumb1",
}  # fmt: skip

_VRM: Final = {
    "root": "hips", "lowerback": "spine", "upperback": "chest", "thorax": "upperChest",
    "lowerneck": "neck", "upperneck": "upperNeck", "head": "head",
    "femur": "UpperLeg", "tibia": "LowerLeg", "foot": "Foot", "toes": "Toes",
    "clavicle": "Shoulder", "humerus": "UpperArm", "radius": "LowerArm",
    "wrist": "LowerArmTwist", "hand": "Hand", "fingers": "MiddleProximal",
    "thumb": "ThumbMetacarpal",
}  # fmt: skip

# Where rigs hang the thumb on the hand, which starts where our thumb does.
_HANGS_ON: Final = {"lthumb": "lhand", "rthumb": "rhand"}


@dataclass(frozen=True, eq=False)
class JointTree:
    """A skeleton under the names of a family.

    Attributes:
        names: of the joints, parents before children.
        parents: index of each joint's parent; -1 for the first.
        bodies: index among `BODY_NAMES` of the body whose frame each joint carries.
        offsets: from the parent to each joint at rest; zero for the first [m].
        ends: from each joint to the far end of its bone at rest [m].
        rest: turn of each joint's bone from the canonical rest pose into the family's.
        carriers: for every body of `BODY_NAMES` the joint that moves it.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    bodies: Int[ndarray, " joints"]
    offsets: Float[ndarray, "joints 3"]
    ends: Float[ndarray, "joints 3"]
    rest: Float[ndarray, "joints 3 3"]
    carriers: tuple[int, ...]

    @property
    def leaves(self) -> tuple[int, ...]:
        """The joints on which no other hangs."""
        return tuple(j for j in range(len(self.names)) if j not in self.parents)

    def rest_positions(self) -> Float[ndarray, "joints 3"]:
        """Where the joints are at rest, from the first one [m]."""
        places = np.zeros((len(self.names), 3))
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                places[joint] = places[parent] + self.offsets[joint]
        return places


def joint_tree(subject: Subject, family: str) -> JointTree:
    """A subject's skeleton under the names of a family.

    Raises:
        MotionError: there is no such family.
    """
    names = joint_names(family)
    order = [name for name in _depth_first("root", names) if name in names]
    above = {name: _parent(name, names) for name in order}
    places = {name: index for index, name in enumerate(order)}
    bodies = np.array([BODY_NAMES.index(name) for name in order])
    turns = np.tile(np.eye(3), (len(BODY_NAMES), 1, 1)) if family == "cmu" else t_pose(subject)
    starts = rest_starts(subject)
    parents = tuple(places.get(above[name], -1) for name in order)
    offsets, ends = np.zeros((2, len(order), 3))
    for joint, parent in enumerate(parents):
        body = bodies[joint]
        if parent >= 0:
            offsets[joint] = turns[bodies[parent]] @ (starts[body] - starts[bodies[parent]])
            ends[joint] = turns[body] @ subject.offsets[body - 1]
    carriers = tuple(
        places[name] if name in places else places[_parent(name, names)] for name in BODY_NAMES
    )
    return JointTree(
        tuple(names[name] for name in order), parents, bodies, offsets, ends, turns[bodies],
        carriers,
    )  # fmt: skip


def joint_names(family: str) -> dict[str, str]:
    """The joint that each body gets in a family; bodies that never turn may have none.

    Raises:
        MotionError: there is no such family.
    """
    if family == "cmu":
        return JOINT_NAMES
    if family not in FAMILIES:
        raise MotionError(f"no names of {family!r}; there are those of {', '.join(FAMILIES)}")
    plain, prefix, sides = (
        (_MIXAMO, "mixamorig:", ("Left", "Right"))
        if family == "mixamo"
        else (_VRM, "", ("left", "right"))
    )
    found = {}
    for body in BODY_NAMES:
        if body in plain:
            found[body] = prefix + plain[body]
        elif body[1:] in plain:
            found[body] = prefix + sides["lr".index(body[0])] + plain[body[1:]]
    return found


def local_turns(
    tree: JointTree, qpos: Float[ndarray, "frames 63"], subject: Subject
) -> Float[ndarray, "frames joints 3 3"]:
    """Turn of every joint against its parent, the first against a y-up world."""
    turns = body_turns(qpos, subject)[:, tree.bodies] @ np.swapaxes(tree.rest, -1, -2)
    local = np.empty_like(turns)
    for joint, parent in enumerate(tree.parents):
        if parent >= 0:
            local[:, joint] = np.swapaxes(turns[:, parent], -1, -2) @ turns[:, joint]
    root = rotations_to_y_up(qpos[:, 3:7]).as_matrix()
    local[:, 0] = root @ tree.rest[0].T
    return local


def root_positions(qpos: Float[ndarray, "frames 63"]) -> Float[ndarray, "frames 3"]:
    """Where the first joint is in a y-up world [m]."""
    return positions_to_y_up(qpos[:, :3])


def _parent(body: str, names: dict[str, str]) -> str:
    """The body on whose joint that of a body hangs; empty for the root's."""
    if body == "root":
        return ""
    if body in _HANGS_ON and names is not JOINT_NAMES:
        return _HANGS_ON[body]
    parent = next(bone.parent for bone in BONES if bone.name == body)
    return parent if parent in names else _parent(parent, names)


def _depth_first(body: str, names: dict[str, str]) -> list[str]:
    children = [bone.name for bone in BONES if _parent(bone.name, names) == body]
    return [body, *(name for child in children for name in _depth_first(child, names))]
