"""Playing a file: where it stands and what each control does, as a pure state machine."""

import math
from dataclasses import dataclass, replace
from typing import Final, Self

SPEEDS: Final = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
"""The speeds that controls step through; 1 is as it was."""


@dataclass(frozen=True, slots=True)
class Playhead:
    """Where playing stands; every control gives another one.

    Attributes:
        frames: how many there are; at least one.
        rate: frames a second [Hz].
        time: since the first frame, from 0 to `seconds`, or in a loop up to a period more, for
            the last frame, too, is seen for a while [s].
        is_playing: whether it goes on by itself.
        speed: 1 for as it was.
        is_looping: whether it begins anew at its end.
    """

    frames: int
    rate: float
    time: float = 0.0
    is_playing: bool = True
    speed: float = 1.0
    is_looping: bool = False

    def __post_init__(self) -> None:
        if self.frames < 1 or not 0.0 < self.rate < math.inf:
            raise ValueError(f"{self.frames} frames at {self.rate} Hz cannot be played")

    @property
    def period(self) -> float:
        """From frame to frame [s]."""
        return 1.0 / self.rate

    @property
    def seconds(self) -> float:
        """From the first frame to the last [s]."""
        return (self.frames - 1) / self.rate

    @property
    def index(self) -> int:
        """The frame to be shown: the newest that is not in the future."""
        # The allowance lets a time that was made of whole frames mean the last of them.
        return min(self.frames - 1, math.floor(self.time * self.rate + 1e-6))

    @property
    def is_at_end(self) -> bool:
        """Whether the last frame is shown."""
        return self.index == self.frames - 1

    def advanced(self, elapsed: float) -> Self:
        """After so much time has passed for whoever looks on [s].

        At the end playing stops, or begins anew after the last frame was seen for as long
        as any other.
        """
        if not self.is_playing:
            return self
        time = self.time + elapsed * self.speed
        if self.is_looping:
            return replace(self, time=time % (self.seconds + self.period))
        if time >= self.seconds:
            return replace(self, time=self.seconds, is_playing=False)
        return replace(self, time=time)

    def scrubbed(self, time: float) -> Self:
        """At another time [s], no farther than the ends."""
        return replace(self, time=min(max(time, 0.0), self.seconds))

    def stepped(self, frames: int) -> Self:
        """So many frames later, or earlier if negative, and paused there."""
        index = min(max(self.index + frames, 0), self.frames - 1)
        return replace(self, time=index / self.rate, is_playing=False)

    def toggled(self) -> Self:
        """Paused if it was playing and the other way round; from the end it starts anew."""
        if self.is_playing:
            return replace(self, is_playing=False)
        return replace(self, is_playing=True, time=0.0 if self.is_at_end else self.time)

    def at_speed(self, speed: float) -> Self:
        """At another speed.

        Raises:
            ValueError: it is not positive.
        """
        if not 0.0 < speed < math.inf:
            raise ValueError(f"a motion cannot be played at {speed} times its speed")
        return replace(self, speed=speed)

    def faster(self) -> Self:
        """At the next higher of `SPEEDS`."""
        return self.at_speed(min((s for s in SPEEDS if s > self.speed), default=self.speed))

    def slower(self) -> Self:
        """At the next lower of `SPEEDS`."""
        return self.at_speed(max((s for s in SPEEDS if s < self.speed), default=self.speed))

    def looping(self, is_looping: bool) -> Self:
        """Beginning anew at the end, or not."""
        return replace(self, is_looping=is_looping)


class Deck:
    """A playhead that is moved by the clock and by whoever sets its attributes.

    Args:
        playhead: where it stands at the beginning.
    """

    def __init__(self, playhead: Playhead) -> None:
        self.playhead = playhead
        self._then: float | None = None

    def tick(self, now: float) -> int:
        """Let it go on until now [s].

        Returns:
            The frame to be shown.
        """
        if self._then is not None:
            self.playhead = self.playhead.advanced(max(0.0, now - self._then))
        self._then = now
        return self.playhead.index

    @property
    def time(self) -> float:
        """Where it stands [s]."""
        return min(self.playhead.time, self.playhead.seconds)

    @time.setter
    def time(self, time: float) -> None:
        self.playhead = self.playhead.scrubbed(time)

    @property
    def seconds(self) -> float:
        """How long it is [s]."""
        return self.playhead.seconds

    @property
    def period(self) -> float:
        """From frame to frame [s]."""
        return self.playhead.period

    @property
    def is_playing(self) -> bool:
        """Whether it goes on by itself."""
        return self.playhead.is_playing

    @is_playing.setter
    def is_playing(self, is_playing: bool) -> None:
        if is_playing != self.playhead.is_playing:
            self.playhead = self.playhead.toggled()

    @property
    def speed(self) -> float:
        """1 for as it was."""
        return self.playhead.speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self.playhead = self.playhead.at_speed(speed)

    @property
    def is_looping(self) -> bool:
        """Whether it begins anew at its end."""
        return self.playhead.is_looping

    @is_looping.setter
    def is_looping(self, is_looping: bool) -> None:
        self.playhead = self.playhead.looping(is_looping)
