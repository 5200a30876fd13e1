"""BVH files under the joint names that a program expects: CMU's, Mixamo's or VRM's.

CMU's names come with the canonical rest pose, the only one that keeps joint angles to the
last digit. Mixamo's and VRM's come with a T pose, from which such programs count rotations.
All are y up, in centimetres, each joint turning as R = Rz Ry Rx.
"""

from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.motion.formats import bvh
from localreg.motion.formats.joint_trees import JointTree, joint_tree, local_turns, root_positions
from localreg.motion.joint_angles import continuous_zyx
from localreg.motion.motion import Motion

_METRES: Final = 0.01
_TURNS: Final = "Zrotation Yrotation Xrotation"


def write(motion: Motion, path: Path, names: str) -> None:
    """Write a motion as a BVH file.

    Args:
        motion: what to write.
        path: the file.
        names: the family of joint names, of `joint_trees.FAMILIES`.
    """
    if names == "cmu":
        bvh.write(motion, path)
        return
    tree = joint_tree(motion.subject, names)
    turns = local_turns(tree, motion.qpos, motion.subject)
    angles = [continuous_zyx(turns[:, joint]) for joint in range(turns.shape[1])]
    values = np.hstack([root_positions(motion.qpos) / _METRES, *map(np.degrees, angles)])
    row = " ".join(["%.6f"] * values.shape[1])
    lines = [
        "HIERARCHY",
        *_joint_lines(tree, 0, ""),
        "MOTION",
        f"Frames: {len(motion)}",
        f"Frame Time: {1.0 / motion.rate:.12f}",
        *(row % tuple(frame) for frame in values.tolist()),
    ]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def _joint_lines(tree: JointTree, joint: int, indent: str) -> list[str]:
    """The lines of a joint and all below it."""
    kind, channels = ("JOINT", f"3 {_TURNS}")
    if tree.parents[joint] < 0:
        kind, channels = "ROOT", f"6 Xposition Yposition Zposition {_TURNS}"
    lines = [
        f"{indent}{kind} {tree.names[joint]}",
        f"{indent}{{",
        f"{indent}\tOFFSET {_vector(tree.offsets[joint])}",
        f"{indent}\tCHANNELS {channels}",
    ]
    children = [child for child, parent in enumerate(tree.parents) if parent == joint]
    for child in children:
        lines += _joint_lines(tree, child, indent + "\t")
    if not children:
        end = _vector(tree.ends[joint])
        lines += [
            f"{indent}\tEnd Site",
            f"{indent}\t{{",
            f"{indent}\t\tOFFSET {end}",
            f"{indent}\t}}",
        ]
    return [*lines, f"{indent}}}"]


def _vector(offset: Float[ndarray, "3"]) -> str:
    return " ".join(f"{value / _METRES:.6f}" for value in offset)
