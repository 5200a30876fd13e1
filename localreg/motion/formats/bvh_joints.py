"""World places and turns of the joints of any BVH file."""

from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.motion.formats.bvh_file import BvhFile
from localreg.motion.formats.text import fault
from localreg.motion.joint_motion import JointMotion, SkeletonTree

# Frames times joints, of 96 bytes each: an hour of a usual skeleton at 240 Hz.
_MOST_PLACES: Final = 40_000_000


def skeleton_tree(file: BvhFile) -> SkeletonTree:
    """The joints of a file and its end sites, at rest where no joint is turned.

    A joint with position channels of its own rests where it is in the middle of the clip,
    for some files give it no offset.
    """
    names = [joint.name for joint in file.joints]
    parents = [joint.parent for joint in file.joints]
    rest = np.zeros((len(names), 3))
    for index, joint in enumerate(file.joints[1:], start=1):
        offset = joint.offset
        if any("position" in channel for channel in joint.channels):
            offset = np.median(file.positions(joint), axis=0)
        rest[index] = rest[joint.parent] + offset
    ends = [(index, joint.end) for index, joint in enumerate(file.joints) if joint.end is not None]
    names += [f"{file.joints[index].name} end" for index, _ in ends]
    parents += [index for index, _ in ends]
    tips = [rest[index] + end for index, end in ends]
    return SkeletonTree(tuple(names), tuple(parents), np.vstack([rest, *tips]))


def joint_motion(file: BvhFile, tree: SkeletonTree, wanted: list[int]) -> JointMotion:
    """How some joints of a file move.

    Args:
        file: the file.
        tree: all its joints, as `skeleton_tree` makes it.
        wanted: the joints to tell of.

    Raises:
        MotionError: there are more frames and joints than memory is meant for.
    """
    needed = _with_ancestors(tree, wanted)
    if len(file.values) * len(needed) > _MOST_PLACES:
        raise fault(
            file.path,
            1,
            f"{len(file.values)} frames of {len(needed)} joints are too many for one reading; "
            "cut the file into takes",
        )
    places: dict[int, tuple[ndarray, ndarray]] = {}
    for joint in needed:
        places[joint] = _place(file, tree, joint, places)
    return JointMotion(
        tree.part(wanted),
        np.stack([places[joint][0] for joint in wanted], axis=1),
        np.stack([places[joint][1] for joint in wanted], axis=1),
        file.rate,
        file.notes,
    )


def _with_ancestors(tree: SkeletonTree, joints: list[int]) -> list[int]:
    needed: set[int] = set()
    for start in joints:
        joint = start
        while joint >= 0 and joint not in needed:
            needed.add(joint)
            joint = tree.parents[joint]
    return sorted(needed)


def _place(
    file: BvhFile, tree: SkeletonTree, index: int, places: dict[int, tuple[ndarray, ndarray]]
) -> tuple[Float[ndarray, "frames 3"], Float[ndarray, "frames 3 3"]]:
    parent = tree.parents[index]
    if index >= len(file.joints):
        position, turn = places[parent]
        end = file.joints[parent].end
        return position + turn @ (np.zeros(3) if end is None else end), turn
    joint = file.joints[index]
    own, inner = file.positions(joint), file.rotations(joint)
    if parent < 0:
        return own, inner
    position, turn = places[parent]
    return position + np.einsum("fij,fj->fi", turn, own), turn @ inner
