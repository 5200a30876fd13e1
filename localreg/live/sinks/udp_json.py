"""Poses as one JSON object a datagram, for programs of a dozen lines.

    {"schema": 1, "instant": 12, "time": 345.678, "held": false,
     "joints": {"lfemurrz": 0.1, ...},
     "bones": {"root": [x, y, z, w, x, y, z], "lhipjoint": [...], ...}}

Metres, radians, right-handed, z up, quaternions w x y z; a bone's pose is that of its start
in the world. A frame is about 4 kB, which a local network delivers in three packets.
"""

import json

import numpy as np

from localreg.body.skeleton import BODY_NAMES, DOF_NAMES
from localreg.body.subject import Subject
from localreg.live.body_frames import ForwardKinematics
from localreg.live.sinks.base import LivePose


class JsonEncoder:
    """One subject's poses as JSON; pure.

    Args:
        subject: whose body.
    """

    def __init__(self, subject: Subject) -> None:
        self._kinematics = ForwardKinematics(subject)

    def __call__(self, live: LivePose) -> list[bytes]:
        """The datagram of one frame; numbers have five decimals."""
        frames = self._kinematics(live.pose.qpos)
        bones = np.hstack([frames.positions, frames.quaternions]).round(5).tolist()
        angles = live.pose.qpos[7:].round(5).tolist()
        document = {
            "schema": 1,
            "instant": live.instant,
            "time": round(live.frame.time, 6),
            "held": live.is_held,
            "joints": dict(zip(DOF_NAMES, angles, strict=True)),
            "bones": dict(zip(BODY_NAMES, bones, strict=True)),
        }
        return [json.dumps(document, separators=(",", ":")).encode()]
