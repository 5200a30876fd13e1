"""The step after the poses: frames of ordinary motion, collected until they are enough.

It knows no view and reads no clock. Frames between which time passed unseen (a pause, trackers
that went away, a crash) begin a new stretch, since nobody knows how the body came there.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.subject import Mount
from sensors import rotation
from sensors.pose import TrackerFrame

NAME: Final = "motion"
"""What the step is called where poses have their names."""

WORDS: Final = (
    "Walk about as you like. Turn both ways, bend and reach, look around, whatever you do often."
)

Stretches = tuple[tuple[TrackerFrame, ...], ...]
"""Frames of motion, one tuple for every time without a gap."""

_GAP: Final = 0.25
_LEAST_TURNS: Final = (float(np.radians(12.0)), float(np.radians(4.0)))
"""A tracker has moved that turned by so much about one axis, and so much about another [rad]."""


class MotionStep:
    """Collects frames, and says which trackers have hardly turned.

    Args:
        trackers: names, in the order of the frames.
        seconds: how much motion is wanted [s].
        reference: the tracker that the others turn against; itself it is to turn in the room.
        least: so many trackers a frame must have [count].
        stretches: of an earlier run that is resumed.
    """

    def __init__(
        self,
        trackers: Sequence[str],
        seconds: float,
        *,
        reference: int = 0,
        least: int = 4,
        stretches: Stretches = (),
    ) -> None:
        self.trackers = tuple(trackers)
        self.seconds = seconds
        self._reference = reference
        self._least = min(least, len(self.trackers))
        self._turns = np.zeros((len(self.trackers), 4, 4))
        self._counts = np.zeros(len(self.trackers))
        self._stretches: list[list[TrackerFrame]] = []
        self._is_enough = False
        for stretch in stretches:
            self.part()
            for frame in stretch:
                self.push(frame)
        self.part()

    @classmethod
    def of(
        cls, mounts: Sequence[Mount], seconds: float, *, stretches: Stretches = ()
    ) -> "MotionStep":
        """For a person who wears these trackers; they turn against the torso's, or the first."""
        bones = [mount.bone for mount in mounts]
        reference = bones.index("thorax") if "thorax" in bones else 0
        names = [mount.tracker for mount in mounts]
        return cls(names, seconds, reference=reference, stretches=stretches)

    @property
    def stretches(self) -> Stretches:
        """What is collected."""
        return tuple(tuple(stretch) for stretch in self._stretches if stretch)

    @property
    def collected(self) -> float:
        """How much motion there is [s]."""
        return sum(s[-1].time - s[0].time for s in self._stretches if s)

    @property
    def is_over(self) -> bool:
        """Whether it is enough, or was declared to be."""
        return self._is_enough or self.collected >= self.seconds

    def finish(self) -> None:
        """What is collected is enough."""
        self._is_enough = True

    def part(self) -> None:
        """What comes next does not go on where the last frame was."""
        if not self._stretches or self._stretches[-1]:
            self._stretches.append([])

    def push(self, frame: TrackerFrame) -> bool:
        """Take a frame; False if too few trackers were seen in it."""
        seen = frame.position_mask & frame.orientation_mask
        if seen.sum() < self._least:
            return False
        last = self._stretches[-1][-1] if self._stretches and self._stretches[-1] else None
        if last is None or not 0.0 < frame.time - last.time < _GAP:
            self.part()
        self._stretches[-1].append(frame)
        if seen[self._reference]:
            turned = rotation.multiply(
                rotation.conjugate(frame.quaternions[self._reference]), frame.quaternions
            )
            turned[self._reference] = frame.quaternions[self._reference]
            self._turns[seen] += turned[seen, :, None] * turned[seen, None, :]
            self._counts[seen] += 1.0
        return True

    def turns(self) -> Float[ndarray, "J 2"]:
        """How far each tracker turned to and fro about its two liveliest axes, rms [rad].

        The second moment of quaternions does not care about their sign; what is off its
        greatest axis is the sine of half the angle.
        """
        moments = self._turns / np.maximum(self._counts, 1.0)[:, None, None]
        values = np.linalg.eigvalsh(moments)[:, [2, 1]]
        return 2.0 * np.arcsin(np.sqrt(np.clip(values, 0.0, 1.0)))

    @property
    def stiff(self) -> tuple[str, ...]:
        """Trackers that have hardly turned, about one axis alone or not at all."""
        moved = np.all(self.turns() > np.array(_LEAST_TURNS), axis=1)
        return tuple(name for name, has in zip(self.trackers, moved, strict=True) if not has)


def at_rate(stretch: Sequence[TrackerFrame], rate: float) -> list[TrackerFrame]:
    """The same motion at another rate: straight lines, and the shortest turns.

    Args:
        stretch: without a gap.
        rate: of what comes out [Hz].
    """
    times = np.array([frame.time for frame in stretch])
    if len(times) < 2 or np.allclose(np.diff(times), 1.0 / rate, rtol=0.02):
        return list(stretch)
    wanted = np.arange(times[0], times[-1], 1.0 / rate)
    after = np.clip(np.searchsorted(times, wanted, side="right"), 1, len(times) - 1)
    shares = (wanted - times[after - 1]) / (times[after] - times[after - 1])
    frames = []
    for t, index, share in zip(wanted.tolist(), after.tolist(), shares.tolist(), strict=True):
        a, b = stretch[index - 1], stretch[index]
        mask = (a.position_mask & b.position_mask, a.orientation_mask & b.orientation_mask)
        places = (1.0 - share) * a.positions + share * b.positions
        turns = rotation.slerp(a.quaternions, b.quaternions, np.full(len(places), share))
        frames.append(TrackerFrame(t, places, turns, *mask))
    return frames


def told(left: float, stiff: Sequence[str]) -> str:
    """How much longer to walk [s], and what has hardly moved so far."""
    words = f"{left:.0f} s to go."
    return words + (f" Hardly turned yet: {', '.join(stiff)}." if stiff else "")
