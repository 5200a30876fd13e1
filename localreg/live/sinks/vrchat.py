"""Poses as VRChat's OSC trackers: eight points of the body and the head, by UDP.

Positions in metres, rotations as Euler angles in degrees, in Unity's axes.
"""

from typing import Final

import numpy as np

from localreg.body.subject import Subject
from localreg.live.body_frames import ForwardKinematics
from localreg.live.sinks.base import LivePose
from localreg.live.sinks.osc_bundle import Message, OscBundle
from localreg.live.unity import HUMAN_BONES, Humanoid
from sensors.protocols import unity

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
        angles = unity.quaternion_to_euler(human.world_quaternions[_BONES][:, [3, 0, 1, 2]])
        return [self._bundle.fill(np.hstack([positions, np.degrees(angles)]).ravel())]
