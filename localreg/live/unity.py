"""A pose as Unity's humanoid has it: left-handed, y up, bones turned against a T-pose.

Three conversions, in this order:

1. *T-pose.* Unity counts a bone's rotation from the pose with arms level and legs straight
   down; our rest pose spreads the legs by 20 degrees. T_bone is the turn that brings a bone
   from the rest pose into the T-pose.
2. *Heading.* Somebody whose bones are all unturned looks along Unity's forward, z, which is
   the world's x. R_ahead is the root's rotation of somebody upright who looks there. The
   bone's rotation since then, in world axes, is R_world T_bone^-1 R_ahead^-1.
3. *Handedness.* `sensors.protocols.unity`, which the trackers come in by, too: what comes in
   by VMC goes out where it was.

Bone names: Unity's HumanBodyBones enumeration. Wire format: x y z w.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import Subject
from localreg.live.body_frames import BodyFrames
from localreg.motion.postures import t_pose
from sensors import rotation
from sensors.protocols import unity

_SIDE: Final = (
    ("Shoulder", "clavicle", "UpperChest"),
    ("UpperArm", "humerus", "Shoulder"),
    ("LowerArm", "radius", "UpperArm"),
    ("Hand", "hand", "LowerArm"),
    ("UpperLeg", "femur", "Hips"),
    ("LowerLeg", "tibia", "UpperLeg"),
    ("Foot", "foot", "LowerLeg"),
    ("Toes", "toes", "Foot"),
)
_TRUNK_NAMES: Final = ("Hips", "Spine", "Chest", "UpperChest", "Neck", "Head")

HUMAN_BONES: Final[dict[str, str]] = {
    "Hips": "root",
    "Spine": "lowerback",
    "Chest": "upperback",
    "UpperChest": "thorax",
    "Neck": "lowerneck",
    "Head": "head",
    **{"Left" + human: "l" + bone for human, bone, _ in _SIDE},
    **{"Right" + human: "r" + bone for human, bone, _ in _SIDE},
}
"""Unity's bones that we move, parents before children, and our bone that starts there."""

HUMAN_PARENTS: Final[dict[str, str]] = {
    "Spine": "Hips",
    "Chest": "Spine",
    "UpperChest": "Chest",
    "Neck": "UpperChest",
    "Head": "Neck",
    **{
        side + human: parent if parent in _TRUNK_NAMES else side + parent
        for side in ("Left", "Right")
        for human, _, parent in _SIDE
    },
}
"""The parent of each of them among the bones that we move; the hips have none."""

_NAMES: Final = tuple(HUMAN_BONES)
_BODIES: Final = np.array([BODY_NAMES.index(body) for body in HUMAN_BONES.values()])
_PARENTS: Final = np.array([_NAMES.index(HUMAN_PARENTS.get(name, "Hips")) for name in _NAMES])

# The root's rotation of somebody upright who looks along the world's x: a quarter turn about
# z from the rest pose's heading, and the quarter turn about x that makes a y-up body upright.
_AHEAD: Final = np.array([0.5, 0.5, 0.5, 0.5])
_XYZW: Final = np.array([1, 2, 3, 0])


class HumanPose(NamedTuple):
    """The bones of `HUMAN_BONES` as Unity has them: left-handed, y up, metres, x y z w.

    Attributes:
        positions: in the parent's axes from the parent's start; the hips' in the world [m].
        quaternions: against the parent, the T-pose being all identities; the hips' in the
            world.
        world_positions: in the world [m].
        world_quaternions: in the world, the T-pose being all identities.
    """

    positions: Float[ndarray, "22 3"]
    quaternions: Float[ndarray, "22 4"]
    world_positions: Float[ndarray, "22 3"]
    world_quaternions: Float[ndarray, "22 4"]


class Humanoid:
    """Translates one subject's poses.

    Args:
        subject: whose rest pose is set against Unity's T-pose.
    """

    def __init__(self, subject: Subject) -> None:
        t_turns = Rotation.from_matrix(t_pose(subject)[_BODIES])
        turns = rotation.multiply(_AHEAD, t_turns.as_quat(canonical=True, scalar_first=True))
        self._from_t_pose = rotation.conjugate(turns)

    def __call__(self, frames: BodyFrames) -> HumanPose:
        """The pose in Unity's terms."""
        world_p = unity.position_from_world(frames.positions[_BODIES])
        turns = rotation.multiply(frames.quaternions[_BODIES], self._from_t_pose)
        world_q = unity.quaternion_from_world(turns)
        to_parent = rotation.conjugate(world_q[_PARENTS])
        p = rotation.rotate(to_parent, world_p - world_p[_PARENTS])
        q = rotation.multiply(to_parent, world_q)
        p[0], q[0] = world_p[0], world_q[0]
        return HumanPose(p, q[:, _XYZW], world_p, world_q[:, _XYZW])
