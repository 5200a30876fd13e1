"""Where the trackers keep being left, and what follows: they are heard again, beliefs fade.

One error far beyond its sigma is an outlier, and the Lorentzian lets go of it; so is one that
came by a jump, for as long as it stays. But an error that grows and lasts says that the
belief keeps the body from where it is, since the database lacks the motion. While one does,
its Lorentzian widens until the measurement pulls again, and all covariances of the belief are
multiplied, as in an adaptive fading Kalman filter (Xia, Rao, Ying and Shen 1994): what is
left of the method then is close to inverse kinematics.
"""

from typing import Final, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float
from numba import njit
from numpy import ndarray

from localreg.synthesis.observation import Observation

_RISES: Final = 2.0
"""Strain grows no faster than by this factor, plus 1, from frame to frame: it takes four frames
of large errors to reach 9 ..."""

_FADES: Final = 0.8
"""... and fades no faster than by this one."""

_LEAP: Final = 0.25
"""A tracker that moves by more in a frame has jumped [m]: no limb is as fast as 10 m/s, which is
that at 40 Hz ..."""

_COSINE_OF_HALF_SPIN: Final = float(np.cos(np.radians(25.0)))
"""... or turns by 50 degrees."""

_MOST: Final = 1000.0
"""Covariances are not multiplied by more."""


class Strain(NamedTuple):
    """How far the trackers keep being left, by position and by orientation.

    Attributes:
        squares: error squared in units of its sigma, as far as it lasts.
        jumped: which errors came by a jump of the tracker and have not ended.
        last: what the trackers said.
        worst: the largest of the squares.
    """

    squares: Float[ndarray, "J 2"]
    jumped: Bool[ndarray, "J 2"]
    last: Observation
    worst: float = 0.0

    @classmethod
    def none(cls, trackers: int) -> "Strain":
        """Before anything was measured."""
        no = np.zeros((trackers, 2), dtype=bool)
        nothing = Observation(np.zeros((trackers, 3)), np.zeros((trackers, 4)), no[:, 0], no[:, 1])
        return cls(np.zeros((trackers, 2)), no, nothing)

    def fading(self, bearable: float) -> float:
        """What covariances of the belief are to be multiplied by; 1 where all is bearable."""
        return max(1.0, min(self.worst / bearable, _MOST))

    def widened(self, lorentzian: Float[ndarray, "J 2"], bearable: float) -> Float[ndarray, "J 2"]:
        """The c of each Lorentzian, larger where it is to pull in spite of a large error."""
        if self.worst <= bearable:
            return lorentzian
        return lorentzian * np.maximum(1.0, self.squares / bearable)

    def after(
        self,
        observation: Observation,
        errors: Float[ndarray, "2 J"],
        sigmas: tuple[float, float],
        bearable: float,
    ) -> "Strain":
        """The strain after a frame.

        Args:
            observation: what the trackers say.
            errors: how far they are from where they are synthesized, [m] and [rad]; NaN where
                not measured.
            sigmas: what they are believed to be off by [m], [rad].
            bearable: squared error in units of sigma at which one has ended.
        """
        squares, jumped = np.empty_like(self.squares), np.empty_like(self.jumped)
        worst = _after(self, observation, errors, sigmas, bearable, squares, jumped)
        return Strain(squares, jumped, observation, worst)


@njit(cache=True)
@no_type_check
def _after(before, observation, errors, sigmas, bearable, squares, jumped):
    worst, last = 0.0, before.last
    for j in range(len(squares)):
        moved = np.sqrt(np.sum(np.square(observation.positions[j] - last.positions[j])))
        alike = abs(np.sum(observation.quaternions[j] * last.quaternions[j]))
        leaps = (
            last.position_mask[j] and moved > _LEAP,
            last.orientation_mask[j] and alike < _COSINE_OF_HALF_SPIN,
        )
        for k in range(2):
            square, was = (errors[k, j] / sigmas[k]) ** 2, before.squares[j, k]
            far = square > bearable  # not where it is NaN
            jumped[j, k] = far and (leaps[k] or before.jumped[j, k])
            if np.isnan(square) or jumped[j, k]:
                square = 0.0
            squares[j, k] = min(max(square, _FADES * was), _RISES * was + 1.0)
            worst = max(worst, squares[j, k])
    return worst
