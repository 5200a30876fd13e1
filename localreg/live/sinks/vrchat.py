"""Poses as VRChat's OSC trackers: eight points of the body and the head, by UDP.

Positions in metres, rotations as Euler angles in degrees, in Unity's axes. Unity turns about
z first, then x, then y: R = Ry Rx Rz.
"""

from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.subject import Subject
from localreg.live.body_frames import ForwardKinematics
from localreg.live.sinks.base import LivePose
from localreg.live.sinks.osc_bundle import Message, OscBundle
from localreg.live.unity import HUMAN_BONES, Humanoid

TRACKERS: Final[dict[str, str]] = {
    "1": "Hips",
    "2": "LeftFoot",
    "3": "RightFoot",
    "4": "LeftLowerLeg",
    "5": "RightLowerLeg",
    "6": "UpperChest",
    "7": "LeftLowerArm",
    "8": "RightLowerArm",
    "head": "Head",
}
"""The name that VRChat gives each tracker, and the bone at whose start it sits."""

_BONES: Final = [list(HUMAN_BONES).index(bone) for bone in TRACKERS.values()]


class VrchatEncoder:
    """One subject's poses as datagrams for VRChat; pure.

    Args:
        subject: whose body.
    """

    def __init__(self, subject: Subject) -> None:
        self._kinematics = ForwardKinematics(subject)
        self._humanoid = Humanoid(subject)
        self._bundle = OscBundle(
            [
                Message(f"/tracking/trackers/{name}/{what}", (), 3)
                for name in TRACKERS
                for what in ("position", "rotation")
            ]
        )

    def __call__(self, live: LivePose) -> list[bytes]:
        """The datagram of one frame."""
        human = self._humanoid(self._kinematics(live.pose.qpos))
        positions = human.world_positions[_BONES]
        angles = unity_euler(human.world_quaternions[_BONES])
        return [self._bundle.fill(np.hstack([positions, np.degrees(angles)]).ravel())]


def unity_euler(quaternions_xyzw: Float[ndarray, "n 4"]) -> Float[ndarray, "n 3"]:
    """Angles about x, y, z with R = Ry Rx Rz, as Unity's inspector shows them [rad].

    Where the person looks straight up or down only y minus or plus z is known; z is 0 then.
    """
    x, y, z, w = quaternions_xyzw.T
    sine = np.clip(2.0 * (w * x - y * z), -1.0, 1.0)
    about_y = np.arctan2(2.0 * (x * z + w * y), 1.0 - 2.0 * (x * x + y * y))
    about_z = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z))
    locked = np.abs(sine) > 1.0 - 1e-12
    about_y = np.where(
        locked, np.arctan2(-2.0 * (x * z - w * y), 1.0 - 2.0 * (y**2 + z**2)), about_y
    )
    return np.stack([np.arcsin(sine), about_y, np.where(locked, 0.0, about_z)], axis=-1)
