"""The eight poses that a person is asked to hold, and a set without much thought.

They were chosen from some two thousand combinations of what arms, legs and head can easily
do, as those that tell most of the nine lengths (`observability` shows how much each tells).
What makes a pose tell much: elbows, wrists, knees and hips bent far and in several ways,
while both feet stay where they are for as long as possible; so the poses that move a foot
come last. Three poses differ between left and right, lest a person facing a picture, or a
pair of trackers, be mirrored unnoticed.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from calibration.posture import Limb, Posture
from localreg.body.skeleton import DOF_BONES, DOF_COUNT, QPOS_SIZE
from localreg.motion.motion import MIRROR_DOFS, MIRROR_SIGNS

FACING: Final = Rotation.from_euler("x", 90.0, degrees=True)
"""From the frame of a person who stands upright to the world: z up, facing world -y."""


@dataclass(frozen=True, eq=False)
class TargetPose:
    """A pose to be held.

    Attributes:
        name: short and unique, for example `"T"`.
        arms: what arms and hands do, in a sentence.
        legs: what legs and trunk do, in a sentence.
        head: where to look, in a sentence.
        posture: the same in directions.
        planted: whether the left and the right foot stand where they stood in the first pose.
        other_angles: joint angles in place of the posture's, for poses that went wrong [rad].
    """

    name: str
    arms: str
    legs: str
    head: str
    posture: Posture
    planted: tuple[bool, bool] = (True, True)
    other_angles: Float[ndarray, "56"] | None = None

    @cached_property
    def angles(self) -> Float[ndarray, "56"]:
        """The joint angles [rad]."""
        return self.posture.angles() if self.other_angles is None else self.other_angles

    @property
    def words(self) -> tuple[str, str, str]:
        """What to do: legs, arms, head."""
        return self.legs, self.arms, self.head

    def qpos(self, height: float = 1.0) -> Float[ndarray, "63"]:
        """The pose itself, facing world -y, its root at a height [m]."""
        qpos = np.zeros(QPOS_SIZE)
        qpos[2] = height
        qpos[3:7] = (FACING * self.posture.root).as_quat(scalar_first=True)
        qpos[7:] = self.angles
        return qpos


_STAND: Final = Limb((0.1, -1.0, 0.0))
# Thigh and shank lean as far outwards as in standing, so that whatever somebody's proportions
# the ankles stay where they are; otherwise nobody could hold the pose and keep both feet.
_KNEES: Final = Limb((0.1, -0.6, 0.8), (0.1, -0.94, -0.34))
_WIDE: Final = Limb((0.5, -0.85, 0.0))
_HEEL: Final = Limb((0.06, -1.0, 0.0), (0.0, -0.1, -1.0))

_BACK: Final = {"handrx": -55.0}  # hands bent back, fingers up
_DOWN: Final = {"handrx": 60.0}  # hands hanging from the wrists

_SIDEWAYS: Final = Limb((1.0, 0.0, 0.0))
_SIDEWAYS_STOP: Final = Limb((1.0, 0.0, 0.0), None, _BACK)
_FORWARD: Final = Limb((0.1, 0.0, 1.0))
_FORWARD_DOWN: Final = Limb((0.1, 0.0, 1.0), None, _DOWN)
_SIDEWAYS_DOWN: Final = Limb((1.0, 0.0, 0.0), None, _DOWN)
_UP: Final = Limb((0.15, 1.0, 0.05))
_UP_BACK: Final = Limb((0.15, 1.0, 0.05), None, _BACK)
_HANGING: Final = Limb((0.12, -1.0, 0.03))
_CURL_BACK: Final = Limb((0.12, -1.0, 0.05), (-0.05, 0.8, 0.6), {"handrx": -50.0})
_CURL_DOWN: Final = Limb((0.12, -1.0, 0.05), (-0.05, 0.8, 0.6), _DOWN)
_SHOULDERS: Final = Limb((1.0, 0.0, 0.1), (-0.75, 0.5, 0.2))

_LOOK_UP: Final = {"lowerneckrx": -12.0, "upperneckrx": -15.0, "headrx": -18.0}
_LOOK_DOWN: Final = {"lowerneckrx": 12.0, "upperneckrx": 15.0, "headrx": 18.0}
_TWIST_LEFT: Final = {"lowerbackry": 15.0, "upperbackry": 15.0, "thoraxry": 15.0}
_BEND_RIGHT: Final = {"lowerbackrz": 12.0, "upperbackrz": 12.0, "thoraxrz": 12.0}
_BOW: Final = {"lowerbackrx": 15.0, "upperbackrx": 12.0, "thoraxrx": 12.0}


def _standing(arms: Limb, right: Limb | None = None, **more: object) -> Posture:
    posture = {"left_leg": _STAND, "right_leg": _STAND, **more}
    return Posture(left_arm=arms, right_arm=right or arms, **posture)


EIGHT_POSES: Final[tuple[TargetPose, ...]] = (
    TargetPose(
        "T",
        "Arms straight out to the sides, level, palms down.",
        "Stand upright, feet as wide as your shoulders. Leave them there for six poses.",
        "Look straight ahead.",
        _standing(_SIDEWAYS),
    ),
    TargetPose(
        "twist",
        "Left arm straight forward from the chest, right arm straight out to its side, both level; "
        "let the hands hang from the wrists.",
        "Keep hips and feet; turn your upper body 45 degrees to the left.",
        "Look where your chest points.",
        _standing(_FORWARD_DOWN, _SIDEWAYS_DOWN, trunk=_TWIST_LEFT),
    ),
    TargetPose(
        "side bend",
        "Upper arms down along the body, elbows bent as far as they go, hands bent back.",
        "Bend your upper body to the right, as far as is easy; feet flat.",
        "Keep the head in line with the back.",
        _standing(_CURL_BACK, trunk=_BEND_RIGHT),
    ),
    TargetPose(
        "ski low",
        "Both arms straight up beside the head, hands bent back as if to hold up the ceiling.",
        "Bend your knees as on skis, hips back, heels on the floor.",
        "Look down at your toes.",
        _standing(_UP_BACK, left_leg=_KNEES, right_leg=_KNEES, lean=30.0, trunk=_LOOK_DOWN),
    ),
    TargetPose(
        "ski wide",
        "Arms straight out to the sides, hands bent back as if to stop two cars.",
        "Bend your knees as before, hips back, heels on the floor.",
        "Look up, as far as is easy.",
        _standing(_SIDEWAYS_STOP, left_leg=_KNEES, right_leg=_KNEES, lean=30.0, trunk=_LOOK_UP),
    ),
    TargetPose(
        "bow",
        "Upper arms out to the sides, fingertips on the shoulders.",
        "Bow forward from the hips with straight legs, until the back slopes at 45 degrees.",
        "Keep the head in line with the back.",
        _standing(_SHOULDERS, lean=40.0, trunk=_BOW),
    ),
    TargetPose(
        "star",
        "Upper arms down along the body, elbows bent as far as they go, hands hanging forward.",
        "Step apart until each leg slants by 30 degrees, both straight.",
        "Look up, as far as is easy.",
        _standing(_CURL_DOWN, left_leg=_WIDE, right_leg=_WIDE, trunk=_LOOK_UP),
        planted=(False, False),
    ),
    TargetPose(
        "heel",
        "Left arm straight up, right arm straight out to its side.",
        "Stand on the left leg; right thigh down, right heel up behind you, shin level.",
        "Look down at your toes.",
        _standing(_UP, _SIDEWAYS, right_leg=_HEEL, trunk=_LOOK_DOWN),
        planted=(False, False),
    ),
)
"""The poses, in the order in which they are asked for."""

NAIVE_POSES: Final[tuple[TargetPose, ...]] = tuple(
    TargetPose(name, "", "", "", _standing(left, right))
    for name, left, right in (
        ("T", _SIDEWAYS, None),
        ("N", _HANGING, None),
        ("forward", _FORWARD, None),
        ("up", _UP, None),
        ("goal", Limb((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), None),
        ("tray", Limb((0.12, -1.0, 0.03), (0.05, 0.0, 1.0)), None),
        ("left up", _UP, _SIDEWAYS),
        ("right forward", _SIDEWAYS, _FORWARD),
    )
)
"""Eight poses as one would first think of them: arms all over, legs and trunk straight."""

_LEGS_AND_ARMS: Final = {
    "arms": ("clavicle", "humerus", "radius", "wrist", "hand", "fingers", "thumb"),
    "legs": ("femur", "tibia", "foot", "toes"),
}


def mirrored(angles: Float[ndarray, "56"]) -> Float[ndarray, "56"]:
    """A pose with left and right exchanged."""
    return angles[MIRROR_DOFS] * MIRROR_SIGNS


def with_swapped(angles: Float[ndarray, "56"], limbs: str) -> Float[ndarray, "56"]:
    """A pose in which only the `"arms"` or only the `"legs"` do what the other side should."""
    whole = mirrored(angles)
    mine = np.array([DOF_BONES[i][1:] in _LEGS_AND_ARMS[limbs] for i in range(DOF_COUNT)])
    return np.where(mine, whole, angles)
