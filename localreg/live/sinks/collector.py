"""Keeps the poses of a run in memory, within a bound."""

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from localreg.body.skeleton import QPOS_SIZE
from localreg.body.subject import Subject
from localreg.errors import LocalregError
from localreg.live.sinks.base import LivePose, Sink
from localreg.motion.motion import Motion, Provenance


class Collector(Sink):
    """The first `capacity` poses; the memory is taken at once and never grows.

    Args:
        capacity: poses kept; 144,000 are an hour at 40 Hz and 80 MB.

    Attributes:
        refused: poses that came after it was full.
    """

    def __init__(self, capacity: int = 144_000) -> None:
        self.refused = 0
        self._count = 0
        self._indices = np.zeros(capacity, dtype=np.int64)
        self._times = np.zeros(capacity)
        self._qpos = np.zeros((capacity, QPOS_SIZE))
        self._held = np.zeros(capacity, dtype=np.bool_)
        self._starts = np.zeros(capacity, dtype=np.bool_)

    def __len__(self) -> int:
        return self._count

    def publish(self, live: LivePose) -> None:
        """Copy the pose."""
        row = self._count
        if row == len(self._times):
            self.refused += 1
            return
        self._indices[row] = live.instant
        self._times[row] = live.frame.time
        self._qpos[row] = live.pose.qpos
        self._held[row] = live.is_held
        self._starts[row] = live.is_start
        self._count = row + 1

    @property
    def indices(self) -> Int[ndarray, " frames"]:
        """Number of each frame's instant; a gap is a frame that never came."""
        return self._indices[: self._count]

    @property
    def times(self) -> Float[ndarray, " frames"]:
        """Instants on the host's monotonic clock [s]."""
        return self._times[: self._count]

    @property
    def qpos(self) -> Float[ndarray, "frames 63"]:
        """The poses: root position [m], root quaternion w x y z, joint angles [rad]."""
        return self._qpos[: self._count]

    @property
    def held(self) -> Bool[ndarray, " frames"]:
        """Which frames show an earlier pose."""
        return self._held[: self._count]

    @property
    def starts(self) -> Bool[ndarray, " frames"]:
        """Where the body was found anew."""
        return self._starts[: self._count]

    def rows_on_grid(self) -> Int[ndarray, " instants"]:
        """For every instant from the first to the last the row of the newest pose."""
        if not self._count:
            return np.zeros(0, dtype=np.int64)
        instants = np.arange(self.indices[0], self.indices[-1] + 1)
        return np.searchsorted(self.indices, instants, side="right") - 1

    def motion(self, subject: Subject, rate: float, name: str) -> Motion:
        """What was collected, at a steady rate; where a frame never came the last one stays.

        Args:
            subject: whose body it is.
            rate: frames a second [Hz].
            name: name of the motion.

        Raises:
            LocalregError: there is not one pose.
        """
        if not self._count:
            raise LocalregError("not one pose came; see that the trackers are on and in range")
        qpos = self.qpos[self.rows_on_grid()]
        return Motion(qpos, rate, subject, Provenance(name))
