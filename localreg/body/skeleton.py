"""The canonical skeleton: which bones there are and how their joints turn.

The topology, joint axes and proportions are those of the Acclaim skeleton that CMU's
motion capture database uses; the figures of the default proportions are those of
dm_control's `humanoid_CMU_V2020.xml` (Apache-2.0) scaled by 1.2, symmetrized and rounded;
the ends of head, toes, fingers and thumbs, which that file has only as shapes, are ours.

Every bone starts at its parent's far end. In the rest pose all bone frames equal the
root frame: x to the left, y up, z forward. A joint turns its bone by

    R = C Rz(z) Ry(y) Rx(x) C^T

with C the bone's ASF `axis` frame, so that the hinge axes are the columns of C.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation


@dataclass(frozen=True, slots=True)
class Bone:
    """One bone of the canonical skeleton, with its default proportions.

    Attributes:
        name: as in CMU's files; `l` and `r` begin the names of paired bones.
        parent: name of the bone (or `"root"`) at whose far end this one starts.
        dofs: the hinges from the parent outwards, a part of `"zyx"`; empty if fixed.
        axis_deg: the ASF `axis` triple: C = Rz(c) Ry(b) Rx(a) of (a, b, c) [deg].
        offset: default vector from the bone's start to its end, in root axes at rest [m].
        limits_deg: anatomical range of each hinge, widened to what CMU's subjects
            really do; soft guidance for solvers, never a clamp [deg].
    """

    name: str
    parent: str
    dofs: str
    axis_deg: tuple[float, float, float]
    offset: tuple[float, float, float]
    limits_deg: tuple[tuple[float, float], ...] = ()


# Ranges follow the joint limits common to CMU's ASF files, symmetrized, and widened
# where an Euler chart needs room (shoulder) or where those limits are tighter than
# the range of motion tables of the American Academy of Orthopaedic Surgeons.
_HIP = ((-60.0, 70.0), (-70.0, 70.0), (-160.0, 40.0))
_SPINE = ((-30.0, 30.0), (-35.0, 35.0), (-30.0, 50.0))
_NECK = ((-35.0, 35.0), (-50.0, 50.0), (-45.0, 50.0))
_SHOULDER = ((-100.0, 110.0), (-100.0, 100.0), (-100.0, 110.0))

_LEG: Final = (
    Bone("lhipjoint", "root", "", (0, 0, 0), (0.1223, -0.1102, 0.0593)),
    Bone("lfemur", "lhipjoint", "zyx", (0, 0, 20), (0.1662, -0.4566, 0.0), _HIP),
    Bone("ltibia", "lfemur", "x", (0, 0, 20), (0.1706, -0.4688, 0.0), ((-10.0, 160.0),)),
    Bone(
        "lfoot", "ltibia", "zx", (-90, 0, 20), (0.0094, -0.0257, 0.1877),
        ((-70.0, 35.0), (-60.0, 60.0)),
    ),
    Bone("ltoes", "lfoot", "x", (-90, 0, 20), (0.0, 0.0, 0.06), ((-90.0, 45.0),)),
)  # fmt: skip

_TRUNK: Final = (
    Bone("lowerback", "root", "zyx", (0, 0, 0), (0.0, 0.1359, -0.0097), _SPINE),
    Bone("upperback", "lowerback", "zyx", (0, 0, 0), (0.0, 0.1363, 0.0011), _SPINE),
    Bone("thorax", "upperback", "zyx", (0, 0, 0), (0.0, 0.1367, 0.0056), _SPINE),
    Bone("lowerneck", "thorax", "zyx", (0, 0, 0), (0.0, 0.1086, 0.0128), _NECK),
    Bone("upperneck", "lowerneck", "zyx", (0, 0, 0), (0.0, 0.1560, -0.0054), _NECK),
    Bone("head", "upperneck", "zyx", (0, 0, 0), (0.0, 0.1100, 0.0), _NECK),
)  # fmt: skip

_ARM: Final = (
    Bone(
        "lclavicle", "thorax", "zy", (0, 0, 0), (0.2160, 0.1080, 0.0129),
        ((-20.0, 35.0), (-30.0, 25.0)),
    ),
    Bone("lhumerus", "lclavicle", "zyx", (180, -30, -90), (0.3322, 0.0, 0.0), _SHOULDER),
    Bone("lradius", "lhumerus", "x", (180, -30, -90), (0.2178, 0.0, 0.0), ((-10.0, 160.0),)),
    Bone("lwrist", "lradius", "y", (0, 90, 90), (0.1089, 0.0, 0.0), ((-20.0, 180.0),)),
    Bone(
        "lhand", "lwrist", "zx", (0, 90, 90), (0.0900, 0.0, 0.0),
        ((-50.0, 50.0), (-90.0, 90.0)),
    ),
    Bone("lfingers", "lhand", "x", (0, 90, 90), (0.0800, 0.0, 0.0), ((0.0, 90.0),)),
    Bone(
        "lthumb", "lwrist", "zx", (-90, 45, 0), (0.0424, 0.0, 0.0424),
        ((-60.0, 60.0), (-45.0, 90.0)),
    ),
)  # fmt: skip

_PAIRED: Final = frozenset(side + bone.name[1:] for bone in (*_LEG, *_ARM) for side in "lr")


def mirror_name(name: str) -> str:
    """The name of the bone on the other side; bones in the middle keep theirs."""
    if name not in _PAIRED:
        return name
    return ("r" if name[0] == "l" else "l") + name[1:]


def _mirror_bone(bone: Bone) -> Bone:
    """The right bone that mirrors a left one: x reflected, so z and y turn the other way."""
    a, b, c = bone.axis_deg
    x, y, z = bone.offset
    limits = tuple(
        (low, high) if dof == "x" else (-high, -low)
        for dof, (low, high) in zip(bone.dofs, bone.limits_deg, strict=True)
    )
    return Bone(
        mirror_name(bone.name), mirror_name(bone.parent), bone.dofs, (a, -b, -c), (-x, y, z), limits
    )


BONES: Final[tuple[Bone, ...]] = (
    *_LEG, *map(_mirror_bone, _LEG), *_TRUNK, *_ARM, *map(_mirror_bone, _ARM),
)  # fmt: skip
"""The 30 bones in the order of CMU's `:bonedata`."""

BONE_NAMES: Final[tuple[str, ...]] = tuple(bone.name for bone in BONES)
"""Names of the 30 bones."""

BODY_NAMES: Final[tuple[str, ...]] = ("root", *BONE_NAMES)
"""Names of the 31 bodies: the root, then the bones."""

DOF_NAMES: Final[tuple[str, ...]] = tuple(bone.name + "r" + d for bone in BONES for d in bone.dofs)
"""Names of the 56 joint angles, for example `lfemurrz`, in the order of every pose."""

DOF_BONES: Final[tuple[str, ...]] = tuple(bone.name for bone in BONES for _ in bone.dofs)
"""The bone that each of the 56 joint angles turns."""

DOF_COUNT: Final = len(DOF_NAMES)
"""Joint degrees of freedom: 56."""

QPOS_SIZE: Final = 7 + DOF_COUNT
"""Length of a pose vector: root position, root quaternion w x y z, joint angles."""

TANGENT_SIZE: Final = 6 + DOF_COUNT
"""Length of a pose increment: root translation, root rotation vector, joint angles."""


def axis_frames(axis_deg: Float[ndarray, "bones 3"]) -> Float[ndarray, "bones 3 3"]:
    """Rotation matrices C = Rz(c) Ry(b) Rx(a) of ASF `axis` triples (a, b, c) [deg]."""
    return Rotation.from_euler("xyz", axis_deg, degrees=True).as_matrix()


def default_offsets() -> Float[ndarray, "30 3"]:
    """Vectors from start to end of the bones of the canonical skeleton [m]."""
    return np.array([bone.offset for bone in BONES])


def default_axis_frames() -> Float[ndarray, "30 3 3"]:
    """Axis frames of the canonical skeleton."""
    return axis_frames(np.array([bone.axis_deg for bone in BONES], dtype=float))


def joint_limits() -> Float[ndarray, "56 2"]:
    """Anatomical range of every joint angle: lower and upper end [rad]."""
    return np.radians([pair for bone in BONES for pair in bone.limits_deg])
