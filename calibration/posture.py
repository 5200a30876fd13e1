"""Poses written as people describe them: where limbs point, which way a knee bends.

Directions are in the frame of a person who stands upright: x to the left, y up, z forward,
like the root frame of the canonical skeleton. Joint angles follow from them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import (
    BODY_NAMES,
    BONE_NAMES,
    BONES,
    DOF_COUNT,
    DOF_NAMES,
    default_axis_frames,
    default_offsets,
)
from localreg.motion.bone_frames import shortest_turn, unit
from localreg.motion.joint_angles import axis_rotations

Direction = tuple[float, float, float]

_FRAMES: Final = default_axis_frames()
_OFFSETS: Final = default_offsets()
_HINGE_COLUMN: Final = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True, slots=True)
class Limb:
    """Where an arm or a leg points.

    Attributes:
        upper: direction of upper arm or thigh; for the left side, the right mirrors it.
        lower: direction of forearm or shin; None for a straight limb.
        turns: further joint angles [deg] by name without the side, for example
            `{"wristry": 90}` to turn the palm up.
    """

    upper: Direction
    lower: Direction | None = None
    turns: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Posture:
    """A whole body.

    Attributes:
        left_arm: the left arm.
        right_arm: the right arm, written as if it were a left one.
        left_leg: the left leg.
        right_leg: the right leg, written as if it were a left one.
        trunk: angles of bones in the middle [deg] by name.
        lean: how far the pelvis leans forward [deg].
    """

    left_arm: Limb
    right_arm: Limb
    left_leg: Limb
    right_leg: Limb
    trunk: Mapping[str, float] = field(default_factory=dict)
    lean: float = 0.0

    @property
    def root(self) -> Rotation:
        """The pelvis against the upright frame."""
        return Rotation.from_euler("x", self.lean, degrees=True)

    def angles(self) -> Float[ndarray, "56"]:
        """The joint angles [rad]."""
        angles = np.zeros(DOF_COUNT)
        for name, degrees in self.trunk.items():
            angles[DOF_NAMES.index(name)] = np.radians(degrees)
        for side, arm, leg in (
            ("l", self.left_arm, self.left_leg),
            ("r", self.right_arm, self.right_leg),
        ):
            for limb, upper, lower in ((arm, "humerus", "radius"), (leg, "femur", "tibia")):
                for name, degrees in limb.turns.items():
                    angles[DOF_NAMES.index(side + name)] = np.radians(
                        _mirrored(name, degrees, side)
                    )
                parent = self.root * _world(angles, BONES[BONE_NAMES.index(side + upper)].parent)
                _point(angles, side + upper, side + lower, limb, parent, side)
        return angles


def _mirrored(name: str, degrees: float, side: str) -> float:
    return degrees if side == "l" or name.endswith("rx") else -degrees


def _point(
    angles: Float[ndarray, "56"], upper: str, lower: str, limb: Limb, parent: Rotation, side: str
) -> None:
    """Set the angles of a ball joint and the hinge after it so that the limb points as said."""
    flip = np.array([1.0 if side == "l" else -1.0, 1.0, 1.0])
    u = parent.inv().apply(unit(np.array(limb.upper) * flip))
    index = BONE_NAMES.index(upper)
    along = unit(_OFFSETS[index])
    hinge = _FRAMES[BONE_NAMES.index(lower)][:, _HINGE_COLUMN["x"]]
    bend = 0.0
    if limb.lower is None:
        turn = Rotation.from_matrix(shortest_turn(along, u))
    else:
        f = parent.inv().apply(unit(np.array(limb.lower) * flip))
        bend = float(np.arccos(np.clip(u @ f, -1.0, 1.0)))
        across = np.cross(hinge, along)
        before = np.stack([along, across, np.cross(along, across)])
        sideways = unit(f - (u @ f) * u)
        after = np.stack([u, sideways, np.cross(u, sideways)])
        turn = Rotation.from_matrix(after.T @ before)
    C = Rotation.from_matrix(_FRAMES[index])
    z, y, x = (C.inv() * turn * C).as_euler("ZYX")
    for name, value in (("rz", z), ("ry", y), ("rx", x)):
        angles[DOF_NAMES.index(upper + name)] = value
    angles[DOF_NAMES.index(lower + "rx")] = bend


def _world(angles: Float[ndarray, "56"], body: str) -> Rotation:
    """The turn of a body against the root."""
    total = Rotation.identity()
    while body != BODY_NAMES[0]:
        bone = BONES[BONE_NAMES.index(body)]
        C = _FRAMES[BONE_NAMES.index(body)]
        turn = C
        for dof in bone.dofs:
            angle = np.array(angles[DOF_NAMES.index(f"{body}r{dof}")])
            turn = turn @ axis_rotations(dof, angle)
        total = Rotation.from_matrix(turn @ C.T) * total
        body = bone.parent
    return total
