"""What every prior has in common: it expects a pose, and remembers what became of it.

A prior turns the past and the present trackers' features into one `Belief`; solvers never
know which prior it came from.
"""

from abc import ABC, abstractmethod
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import TANGENT_SIZE
from localreg.database.neighbours import Neighbours, Query
from localreg.synthesis.belief import Belief
from localreg.synthesis.easy_poses import EASE, easy_poses
from localreg.synthesis.linear_algebra import positive_inverse
from localreg.synthesis.observation import Observation
from localreg.synthesis.state import State

STARTS: Final = 8
"""How many joint angles a pose is sought from when there is no past."""

_USUAL_STEP: Final = np.repeat([0.03, np.radians(3.0)], [3, TANGENT_SIZE - 3])
"""Deviation of a pose from that of the frame before: root position [m], all angles [rad]."""


class Expectation(NamedTuple):
    """What a prior expects of the present frame.

    Attributes:
        belief: the Gaussian that enters the energy.
        drift: how the past's prediction is expected to be wrong; the prior's own business.
        caution: how large errors are in units of what the belief predicts.
        confidence: 0 to 1, how well the database knows what is being seen; NaN without one.
        surprise: squared distance of the neighbours, in units of the usual; NaN where that
            is not known.
        near: the neighbours that it comes from.
    """

    belief: Belief
    drift: Any = None
    caution: float = 1.0
    confidence: float = float("nan")
    surprise: float = float("nan")
    near: Neighbours | None = None


class Acquisition(NamedTuple):
    """Where to look for a pose from nothing.

    Attributes:
        starts: joint angles to start from, S of them [rad].
        mean: of the joint angles without a past [rad].
        information: their inverse covariance.
    """

    starts: Float[ndarray, "S 56"]
    mean: Float[ndarray, "56"]
    information: Float[ndarray, "56 56"]


class Prior(ABC):
    """One method's belief."""

    @abstractmethod
    def expect(self, query: Query, state: State) -> Expectation:
        """Predict the present frame from the past and the present trackers' features."""

    def conclude(
        self,
        expectation: Expectation,
        qpos: Float[ndarray, "63"],
        covariance: Float[ndarray, "62 62"],
    ) -> Any:
        """What to remember, beside the pose, of a frame that has been solved."""
        return None

    def acquire_plainly(self) -> Acquisition | None:
        """Where to look for a rival of a pose, whatever the database holds.

        None for methods that do not tell how well the database knows a pose.
        """
        return None

    def most_alike(self, observation: Observation) -> Float[ndarray, "56"] | None:
        """Joint angles that put the trackers about where they are, however the body is turned.

        None for methods without a database, or where too few positions are measured.
        """
        return None

    @abstractmethod
    def acquire(self, query: Query) -> Acquisition:
        """Say where to look when there is no past."""


def plain_acquisition() -> Acquisition:
    """A wide pull to easy standing, from several starts."""
    starts = easy_poses()
    return Acquisition(starts, starts[0], np.eye(starts.shape[1]) / EASE**2)


def plain_expectation(state: State) -> Expectation:
    """The pose as it was, moved as fast as people do."""
    spread = np.array(state.covariance, dtype=float)
    spread[np.diag_indices(len(spread))] += np.square(_USUAL_STEP)
    qpos = np.array(state.qpos, dtype=float)
    return Expectation(Belief(qpos, np.zeros(len(spread)), positive_inverse(spread)))


def spread_starts(
    mean: Float[ndarray, "56"], poses: Float[ndarray, "K 56"]
) -> Float[ndarray, "S 56"]:
    """A prediction and, from near to far, some examples."""
    stride = max(1, len(poses) // (STARTS - 1))
    return np.concatenate([mean[None], poses[::stride][: STARTS - 1]])
