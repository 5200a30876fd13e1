"""Writes a run as a motion file when it ends."""

from pathlib import Path

from localreg.body.subject import Subject
from localreg.live.sinks.base import LivePose, Sink
from localreg.live.sinks.collector import Collector
from localreg.motion.formats.registry import write_motion


class MotionFile(Sink):
    """A file of the kind its ending tells, for example BVH.

    The file is written by `close`, since most kinds begin with their number of frames.
    Frames that never came repeat the pose before, so the file keeps time.

    Args:
        path: the file.
        subject: whose body it is.
        rate: frames a second [Hz].
        capacity: most poses written; later ones are refused and counted.
    """

    def __init__(self, path: Path, subject: Subject, rate: float, capacity: int = 144_000) -> None:
        self.path = path
        self.collected = Collector(capacity)
        self._subject = subject
        self._rate = rate
        self._is_written = False

    def publish(self, live: LivePose) -> None:
        """Keep the pose for later."""
        self.collected.publish(live)

    def close(self) -> None:
        """Write the file, unless nothing came.

        Raises:
            MotionError: it cannot be written.
        """
        if self._is_written or not len(self.collected):
            return
        motion = self.collected.motion(self._subject, self._rate, self.path.stem)
        write_motion(motion, self.path)
        self._is_written = True
