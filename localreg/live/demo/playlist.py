"""Clips one after another on one time axis, and what is true at any instant of it.

Row n of the playlist is due n / rate seconds after motion zero. Clips stay where they were
recorded, so there is a jump from the last row of one to the first of the next.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation, Slerp

from localreg.body.subject import Subject
from localreg.errors import LocalregError
from localreg.evaluation.body_points import BodyPoints
from localreg.motion.motion import Motion
from sensors.emulators.source import Playback


@dataclass(frozen=True, eq=False)
class Playlist:
    """What is played.

    Attributes:
        clips: in the order of playing, all of one body and one rate; at least two frames
            each.
        starts: row of each clip's first frame, and the number of all rows.
    """

    clips: tuple[Motion, ...]
    starts: Int[ndarray, " seams"]

    @classmethod
    def of(cls, motions: Sequence[Motion], rate: float, seconds: float | None = None) -> Self:
        """The whole list once, or so many seconds of it, over and over if need be.

        Args:
            motions: the clips.
            rate: frames a second [Hz].
            seconds: how long to play [s].

        Raises:
            LocalregError: there is nothing to play, or the clips are of several bodies.
        """
        clips = [clip for m in motions if len(clip := m.resampled(rate)) > 1]
        if not clips:
            raise LocalregError("there is no clip to play; give motions of two frames or more")
        if not all(clip.subject.same_proportions(clips[0].subject) for clip in clips):
            raise LocalregError("the clips to play are of several bodies; play them one by one")
        if seconds is not None:
            clips = _cut(clips, max(2, round(seconds * rate)))
        starts = np.concatenate([[0], np.cumsum([len(clip) for clip in clips])])
        return cls(tuple(clips), starts)

    @property
    def rate(self) -> float:
        """Rows a second [Hz]."""
        return self.clips[0].rate

    @property
    def subject(self) -> Subject:
        """Whose body moves."""
        return self.clips[0].subject

    @property
    def rows(self) -> int:
        """How many there are."""
        return int(self.starts[-1])

    @property
    def seconds(self) -> float:
        """Duration, one period for every row [s]."""
        return self.rows / self.rate

    def clip_at(self, t: float) -> int:
        """Index of the clip on at motion time t [s]: that of the nearest row."""
        row = min(max(round(t * self.rate), 0), self.rows - 1)
        return int(np.searchsorted(self.starts, row, side="right")) - 1

    def pose(self, row: int) -> Float[ndarray, "63"]:
        """The true pose of a row."""
        clip = int(np.searchsorted(self.starts, row, side="right")) - 1
        return self.clips[clip].qpos[row - self.starts[clip]]

    def truth(self, clip: int, times: Float[ndarray, " frames"]) -> Float[ndarray, "frames 63"]:
        """The true poses of a clip at any instants, between its frames too.

        Frames lie on the assembler's grid, which follows the samples and need not meet the
        rows. Between two rows positions and angles go straight (the shorter way round), the
        root's rotation along the arc; beyond the clip's ends its end poses stay.

        Args:
            clip: its index.
            times: motion time, not of the clip but of the list [s].
        """
        qpos = self.clips[clip].qpos
        at = np.clip(times * self.rate - self.starts[clip], 0.0, len(qpos) - 1.0)
        before = np.minimum(at.astype(int), len(qpos) - 2)
        f = (at - before)[:, None]
        a, b = qpos[before], qpos[before + 1]
        turn = (b[:, 7:] - a[:, 7:] + np.pi) % (2.0 * np.pi) - np.pi
        root = Rotation.from_quat(qpos[:, 3:7], scalar_first=True)
        quaternions = Slerp(np.arange(len(qpos)), root)(at).as_quat(scalar_first=True)
        return np.hstack([(1.0 - f) * a[:, :3] + f * b[:, :3], quaternions, a[:, 7:] + f * turn])

    def playback(self) -> Playback:
        """What the emulator plays: the noise-free poses of the subject's trackers."""
        qpos = np.concatenate([clip.qpos for clip in self.clips])
        poses = BodyPoints(self.subject).tracker_poses(qpos)
        times = np.arange(self.rows) / self.rate
        return Playback(times, poses.positions, poses.quaternions, self.subject.trackers)


def _cut(clips: list[Motion], rows: int) -> list[Motion]:
    """Clips over and over until there are so many rows; no remainder of a single row."""
    played: list[Motion] = []
    for clip in itertools.cycle(clips):
        left = rows - sum(len(c) for c in played)
        if left < 2:
            return played
        played.append(clip.first(left))
    return played
