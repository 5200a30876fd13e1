"""Poses as a stream of the Lab Streaming Layer, in the layout of its MoCap type.

For the root and each bone seven channels: the position of its start in the world [m], then
the quaternion as Orientation A (w), B, C, D (x, y, z). Samples carry the capture instant of
their frame on LSL's clock. The layer announces itself to the network and listens on all of
the machine's addresses: it cannot be kept to the loopback, so it is used only when asked for.
"""

import os
import time
from typing import Any, Final

import numpy as np

from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import Subject
from localreg.errors import LocalregError
from localreg.live.body_frames import ForwardKinematics
from localreg.live.sinks.base import LivePose, Sink

STREAM: Final = "MoCap"
"""Name of the stream unless told otherwise, and its type."""

_QUANTITIES: Final = (
    ("PositionX", "meters"), ("PositionY", "meters"), ("PositionZ", "meters"),
    ("OrientationA", "quaternion"), ("OrientationB", "quaternion"),
    ("OrientationC", "quaternion"), ("OrientationD", "quaternion"),
)  # fmt: skip

_BUFFERED: Final = 10
"""What is kept for a listener that falls behind [s]."""


class Lsl(Sink):
    """Streams every pose to whoever on the network listens.

    Args:
        subject: whose body.
        rate: frames a second [Hz].
        stream: name of the stream.

    Raises:
        LocalregError: the library is not installed.
    """

    def __init__(self, subject: Subject, rate: float, stream: str = STREAM) -> None:
        try:
            import pylsl
        except (ImportError, RuntimeError) as error:
            raise LocalregError(
                "the Lab Streaming Layer is not installed; run: pip install localreg-mocap[lsl]"
            ) from error
        self.name = f"lsl stream {stream}"
        self._kinematics = ForwardKinematics(subject)
        self._clock = pylsl.local_clock
        source = f"localreg-{os.getpid()}-{stream}"
        info = pylsl.StreamInfo(
            stream, STREAM, len(BODY_NAMES) * len(_QUANTITIES), rate, pylsl.cf_float32, source
        )
        _describe(info, subject)
        self._outlet: Any = pylsl.StreamOutlet(info, max_buffered=_BUFFERED)

    def publish(self, live: LivePose) -> None:
        """Push one sample."""
        frames = self._kinematics(live.pose.qpos)
        sample = np.hstack([frames.positions, frames.quaternions]).astype(np.float32)
        age = time.monotonic() - live.frame.time
        self._outlet.push_sample(sample.ravel().tolist(), self._clock() - age)

    def close(self) -> None:
        """Take the stream off the network."""
        self._outlet = None


def _describe(info: Any, subject: Subject) -> None:
    channels = info.desc().append_child("channels")
    for body in BODY_NAMES:
        for kind, unit in _QUANTITIES:
            channel = channels.append_child("channel")
            channel.append_child_value("label", f"{body}_{kind}")
            channel.append_child_value("object", body)
            channel.append_child_value("type", kind)
            channel.append_child_value("unit", unit)
    setup = info.desc().append_child("setup")
    setup.append_child_value("subject", subject.name)
    setup.append_child_value("axes", "right-handed, z up")
    acquisition = info.desc().append_child("acquisition")
    acquisition.append_child_value("manufacturer", "localreg")
