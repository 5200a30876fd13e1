"""Where the trackers keep being left, and what follows: they are heard again, beliefs fade.

One error far beyond its sigma is an outlier, and the Lorentzian lets go of it; so is one that
came by a jump, for as long as it stays. Noise goes in all directions. But an error that keeps
its direction says that the belief keeps the body from where it is, since the database lacks
the motion. While one does, its Lorentzian widens until the measurement pulls again, and all
covariances of the belief are multiplied, as in an adaptive fading Kalman filter (Xia, Rao,
Ying and Shen 1994): what is left of the method then is close to inverse kinematics.
"""

from typing import Final, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray

from localreg.synthesis.observation import Observation

_SHARE: Final = 0.125
"""Weight of the newest frame in running means."""

_BY_CHANCE: Final = 3.0 * _SHARE / (2.0 - _SHARE)
"""What errors without any direction leave of their mean square in the square of their mean:
three times its expectation."""

_LEAP: Final = 0.25
"""A tracker that is farther from where it was last believed has jumped [m]: no limb is as fast as
10 m/s, which is that in a frame at 40 Hz ..."""

_COSINE_OF_HALF_SPIN: Final = float(np.cos(np.radians(25.0)))
"""... or is turned by 50 degrees."""

_MOST: Final = 1000.0
"""Covariances are not multiplied by more."""


class Strain(NamedTuple):
    """How far the trackers keep being left, by position and by orientation.

    Attributes:
        means: running means of the error vectors in units of their sigmas.
        squares: running means of their squares.
        lasting: squares of the means, less what noise as large may leave there.
        believed: what trackers said last that was no jump; a mask is false where a tracker then
            measured nothing.
        worst: the largest of what lasts.
    """

    means: Float[ndarray, "2 J 3"]
    squares: Float[ndarray, "2 J"]
    lasting: Float[ndarray, "2 J"]
    believed: Observation
    worst: float = 0.0

    @classmethod
    def none(cls, trackers: int) -> "Strain":
        """Before anything was measured."""
        no = np.zeros(trackers, dtype=bool)
        nothing = Observation(np.zeros((trackers, 3)), np.zeros((trackers, 4)), no, no)
        squares, lasting = np.zeros((2, 2, trackers))
        return cls(np.zeros((2, trackers, 3)), squares, lasting, nothing)

    def fading(self, bearable: float) -> float:
        """What covariances of the belief are to be multiplied by; 1 where all is bearable."""
        return max(1.0, min(self.worst / bearable, _MOST))

    def widened(
        self, lorentzian: Float[ndarray, "J 2"], observation: Observation, bearable: float
    ) -> Float[ndarray, "J 2"]:
        """The c of each Lorentzian, larger where it is to pull in spite of a large error."""
        if self.worst <= bearable:
            return lorentzian
        wider = np.maximum(1.0, self.lasting.T / bearable)
        return np.where(_jumped(self.believed, observation), lorentzian, lorentzian * wider)

    def after(
        self,
        observation: Observation,
        errors: tuple[Float[ndarray, "J 3"], Float[ndarray, "J 3"]],
        sigmas: tuple[float, float],
        bearable: float,
    ) -> "Strain":
        """The strain after a frame.

        Args:
            observation: what the trackers say.
            errors: from there to where they are synthesized, [m] and rotation vectors [rad].
            sigmas: what they are believed to be off by [m], [rad].
            bearable: squared error in units of sigma up to which even a jump is believed.
        """
        after = np.empty_like(self.means), np.empty_like(self.squares), np.empty_like(self.lasting)
        worst, jumped = _follow(
            self.means, self.squares, self.believed, observation, errors, sigmas, bearable, after
        )
        believed = observation
        if jumped.any():
            at, turned = jumped.T[:, :, None]
            believed = observation._replace(
                positions=np.where(at, self.believed.positions, observation.positions),
                quaternions=np.where(turned, self.believed.quaternions, observation.quaternions),
            )
        return Strain(*after, believed, worst)


@njit(cache=True)
@no_type_check
def _jumped(believed, observation):
    """Which trackers are far from where they were last believed, by position and orientation."""
    jumped = np.zeros((len(observation.positions), 2), np.bool_)
    for j in range(len(jumped)):
        moved = alike = 0.0
        for i in range(3):
            moved += (observation.positions[j, i] - believed.positions[j, i]) ** 2
        for i in range(4):
            alike += observation.quaternions[j, i] * believed.quaternions[j, i]
        jumped[j, 0] = believed.position_mask[j] and moved > _LEAP**2
        jumped[j, 1] = believed.orientation_mask[j] and abs(alike) < _COSINE_OF_HALF_SPIN
    return jumped


@njit(cache=True)
@no_type_check
def _follow(means_before, squares_before, believed, observation, errors, sigmas, bearable, after):
    """Write means, squares and what lasts; returns the worst, and which trackers have jumped."""
    means, squares, lasting = after
    worst, jumped = 0.0, _jumped(believed, observation)
    for k in range(2):
        measured = observation.position_mask if k == 0 else observation.orientation_mask
        for j in range(len(measured)):
            square = length = 0.0
            for i in range(3):
                square += (errors[k][j, i] / sigmas[k]) ** 2
            jumped[j, k] = jumped[j, k] and square > bearable
            share = _SHARE if measured[j] and not jumped[j, k] else 0.0
            for i in range(3):
                error = errors[k][j, i] / sigmas[k]
                means[k, j, i] = (1.0 - _SHARE) * means_before[k, j, i] + share * error
                length += means[k, j, i] ** 2
            squares[k, j] = (1.0 - _SHARE) * squares_before[k, j] + share * square
            lasting[k, j] = max(0.0, length - _BY_CHANCE * squares[k, j])
            worst = max(worst, lasting[k, j])
    return worst, jumped
