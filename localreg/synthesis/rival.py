"""Whether the trackers would be better explained by another pose.

Two poses can put six trackers into the same places: an arm turned the other way round at the
shoulder and back at the wrist. Once the wrong one is taken, the past speaks for it, and its
energy is hardly higher. What gives it away is that the database has seen nothing like it. So
beside a pose that was found from one frame with the help of the database another is followed
that was found without, and where neighbours stay far, such a *rival* is sought anew. It takes
the pose's place if the database knows it clearly better after some frames: two hypotheses, as
in tracking by multiple hypotheses (Reid 1979).
"""

from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

_SHARE: Final = 0.1
"""Weight of the newest frame in the running mean of surprise."""

_AT_FIRST: Final = 0.5
"""Surprise that a pose found from one frame alone begins with."""

_REST: Final = 10
"""Frames between one rival and the next; twice as many after each that was given up ..."""

_LONGEST_REST: Final = 80
"""... up to so many."""

_LOOKS: Final = (6, 12, 24)
"""After so many frames beside a rival the later half of them are compared."""

_CLEARLY: Final = 1.3
"""How many times as far the present pose's neighbours must be."""

_HOPELESS: Final = 3.0
"""How many times as far the rival's neighbours may be at a look."""

_APART: Final = np.radians(1.0)
"""Poses whose joint angles differ by less on average are the same pose [rad]."""


class Doubt(NamedTuple):
    """How well the present pose has lately been known, and what is held against it.

    Attributes:
        surprise: running mean of the neighbours' squared distance, in units of the usual.
        rest: frames until a rival may be sought.
        pause: frames of rest once the next rival is given up.
        rival: the rival's state (`localreg.synthesis.state.State`) after the last frame; None
            if there is none.
        followed: for how many frames there has been one.
        far: sum of the present pose's surprises over the frames that the next look compares.
        rivals_far: sum of the rival's.
    """

    surprise: float = _AT_FIRST
    rest: int = _REST
    pause: int = _REST
    rival: Any = None
    followed: int = 0
    far: float = 0.0
    rivals_far: float = 0.0

    def after(self, surprise: float) -> "Doubt":
        """The doubt after a frame of so much surprise."""
        mean = (1.0 - _SHARE) * self.surprise + _SHARE * surprise
        return self._replace(surprise=mean, rest=max(0, self.rest - 1))

    def challenged_by(self, rival: Any) -> "Doubt":
        """The doubt with a rival that has just been found."""
        return self._replace(rival=rival, followed=0, far=0.0, rivals_far=0.0)

    def wants_a_rival(self, bearable: float) -> bool:
        """Whether it is time to look for another pose; never where surprise is not known."""
        return self.rival is None and self.rest == 0 and self.surprise > bearable

    def beside(self, surprise: float, rival: Any, rivals_surprise: float) -> "Doubt":
        """The doubt after a frame that the rival was followed through, too."""
        anew = 2 * self.followed in _LOOKS
        far, rivals_far = (0.0, 0.0) if anew else (self.far, self.rivals_far)
        return self._replace(
            rival=rival,
            followed=self.followed + 1,
            far=far + surprise,
            rivals_far=rivals_far + rivals_surprise,
        )

    @property
    def prefers_the_rival(self) -> bool:
        """Whether it is time to look, and the database knows the rival clearly better."""
        return self.followed in _LOOKS and self.far > _CLEARLY * self.rivals_far

    @property
    def is_over(self) -> bool:
        """Whether the rival has been followed for long enough."""
        is_hopeless = self.followed in _LOOKS and self.rivals_far > _HOPELESS * self.far
        return is_hopeless or self.followed >= _LOOKS[-1]

    @property
    def settled_on_the_rival(self) -> "Doubt":
        """The doubt once the rival has taken the pose's place."""
        compared = self.followed - self.followed // 2
        return Doubt(surprise=self.rivals_far / compared)

    @property
    def settled(self) -> "Doubt":
        """The doubt once the rival has been given up."""
        longer = min(2 * self.pause, _LONGEST_REST)
        return Doubt(surprise=self.surprise, rest=self.pause, pause=longer)


def are_apart(one: Float[ndarray, "63"], other: Float[ndarray, "63"]) -> bool:
    """Whether two poses are different ones."""
    return bool(np.mean(np.abs(one[7:] - other[7:])) > _APART)
