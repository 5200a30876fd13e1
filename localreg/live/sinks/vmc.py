"""Poses to avatar programs by the Virtual Motion Capture protocol (VMC), OSC over UDP.

Every frame is two bundles below the size of an Ethernet packet, and one message for each
tracker that was measured. Bones are named as in Unity's HumanBodyBones; positions are in
metres, rotations x y z w, both against the parent, left-handed and y up.
"""

from typing import Final

import numpy as np

from localreg.body.subject import Subject
from localreg.live.body_frames import ForwardKinematics
from localreg.live.sinks.base import LivePose
from localreg.live.sinks.osc_bundle import Message, OscBundle
from localreg.live.unity import HUMAN_BONES, Humanoid
from sensors.protocols import unity

_ROOT: Final = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
_FIRST: Final = 14
"""Bones in the first bundle: with these both stay below 1400 bytes."""


class VmcEncoder:
    """One subject's poses as VMC datagrams; pure.

    Args:
        subject: whose body, wearing the trackers of the frames.
    """

    def __init__(self, subject: Subject) -> None:
        self._kinematics = ForwardKinematics(subject)
        self._humanoid = Humanoid(subject)
        bones = [Message("/VMC/Ext/Bone/Pos", (name,), 7) for name in HUMAN_BONES]
        head = [
            Message("/VMC/Ext/OK", (1,)),
            Message("/VMC/Ext/T", (), 1),
            Message("/VMC/Ext/Root/Pos", ("root",), 7),
        ]
        self._bundles = OscBundle([*head, *bones[:_FIRST]]), OscBundle(bones[_FIRST:])
        self._trackers = [
            OscBundle([Message("/VMC/Ext/Tra/Pos", (name,), 7)]) for name in subject.trackers
        ]
        self._zero: float | None = None

    def __call__(self, live: LivePose) -> list[bytes]:
        """The datagrams of one frame; time counts from the first frame."""
        time = live.frame.time
        self._zero = time if self._zero is None else self._zero
        human = self._humanoid(self._kinematics(live.pose.qpos))
        bones = np.hstack([human.positions, human.quaternions]).ravel()
        first = np.concatenate([[time - self._zero], _ROOT, bones[: 7 * _FIRST]])
        datagrams = [self._bundles[0].fill(first), self._bundles[1].fill(bones[7 * _FIRST :])]
        frame = live.frame
        positions = unity.position_from_world(frame.positions)
        quaternions = unity.quaternion_from_world(frame.quaternions)[:, [1, 2, 3, 0]]
        for j, tracker in enumerate(self._trackers):
            if frame.position_mask[j] and frame.orientation_mask[j]:
                datagrams.append(tracker.fill(np.concatenate([positions[j], quaternions[j]])))
        return datagrams
