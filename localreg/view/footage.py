"""A motion from a file, made ready to be seen frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.drawing.ground import end_heights, floor_under
from localreg.errors import LocalregError
from localreg.motion.motion import Motion
from localreg.view.moment import TRAIL_SECONDS, Moment, Observer
from sensors.pose import TrackerFrame

_ENOUGH: Final = 400  # frames to find the floor by


@dataclass(frozen=True, eq=False)
class Footage:
    """What a file shows.

    Attributes:
        motion: the body.
        frames: what the trackers said, one entry a frame; None where nothing was measured,
            and trackers are shown where the body wears them.
        ghost: another motion to compare with, at any rate, from the same instant on.
        ghost_name: what it is, for example `"truth"`.
        confidence: 0 to 1, one a frame; None if unknown.
        held: frames that show an earlier pose; None for none.
        starts: frames in which the body was found anew; None for none.
    """

    motion: Motion
    frames: Sequence[TrackerFrame] | None = None
    ghost: Motion | None = None
    ghost_name: str = ""
    confidence: Float[ndarray, " frames"] | None = None
    held: Bool[ndarray, " frames"] | None = None
    starts: Bool[ndarray, " frames"] | None = None

    def __post_init__(self) -> None:
        name = self.motion.provenance.name
        if not len(self.motion):
            raise LocalregError(f"{name} has no frames; there is nothing to see")
        if self.ghost is not None and not len(self.ghost):
            raise LocalregError(f"{self.ghost.provenance.name} has no frames to compare with")
        if self.frames is not None and len(self.frames) != len(self.motion):
            raise LocalregError(
                f"{name} has {len(self.motion)} poses and {len(self.frames)} frames of trackers"
            )

    @property
    def title(self) -> str:
        """Name of the motion, and what is done in it."""
        provenance = self.motion.provenance
        return f"{provenance.name}  {provenance.activity}".strip()

    def on_floor(self) -> "Footage":
        """The same with the floor at height 0, found from the feet of the motion.

        Motions that were captured elsewhere stand on floors of their own heights.
        """
        floor = floor_under(end_heights(self.motion, _ENOUGH))
        frames = self.frames
        if frames is not None:
            down = np.array([0.0, 0.0, floor])
            frames = [frame._replace(positions=frame.positions - down) for frame in frames]
        ghost = None if self.ghost is None else _lowered(self.ghost, floor)
        return replace(self, motion=_lowered(self.motion, floor), frames=frames, ghost=ghost)


class Reel:
    """The moments of footage, in any order; in order they are made fastest.

    Args:
        footage: where they come from.
        trail_seconds: how far back trails reach [s]; 0 for none.
    """

    def __init__(self, footage: Footage, trail_seconds: float = TRAIL_SECONDS) -> None:
        self.footage = footage
        self._observer = Observer(footage.motion.subject, trail_seconds=trail_seconds)
        self._past = int(trail_seconds * footage.motion.rate)
        self._last: int | None = None

    def __len__(self) -> int:
        return len(self.footage.motion)

    def moment(self, index: int) -> Moment:
        """What is to be seen of one frame."""
        footage, motion = self.footage, self.footage.motion
        when = index / motion.rate
        self._catch_up(index)
        qpos = motion.qpos[index]
        frames = footage.frames
        frame = self._observer.worn(when, qpos) if frames is None else frames[index]
        moment = self._observer.observe(when, qpos, frame, is_start=self._is_start(index))
        self._last = index
        ghost = None
        if footage.ghost is not None:
            row = round(when * footage.ghost.rate)
            ghost = footage.ghost.qpos[min(row, len(footage.ghost) - 1)]
        return replace(
            moment,
            index=index,
            ghost=ghost,
            ghost_name=footage.ghost_name,
            confidence=np.nan if footage.confidence is None else float(footage.confidence[index]),
            is_held=footage.held is not None and bool(footage.held[index]),
            title=footage.title,
        )

    def _catch_up(self, index: int) -> None:
        """Let the observer see what trails need, wherever the last frame was."""
        first = max(0, index - self._past)
        if self._last is not None and first <= self._last < index:
            first = self._last + 1
        else:
            self._observer.forget()
        rate, qpos = self.footage.motion.rate, self.footage.motion.qpos
        for past in range(first, index):
            self._observer.pass_by(past / rate, qpos[past], is_start=self._is_start(past))

    def _is_start(self, index: int) -> bool:
        starts = self.footage.starts
        return starts is not None and bool(starts[index])


def _lowered(motion: Motion, floor: float) -> Motion:
    qpos = motion.qpos.copy()
    qpos[:, 2] -= floor
    return replace(motion, qpos=qpos)
