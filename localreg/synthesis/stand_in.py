"""An estimator without a database, for whoever wants the code of frames compiled early.

What it runs, it runs with the types of the default method: attention, regression, solver. What
needs a database to be compiled (features, search, rehearsal, drift) is missing, and takes a
little longer; so two processes can compile at once, each about half.
"""

from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.chain import chain_of
from localreg.body.skeleton import DOF_COUNT, TANGENT_SIZE
from localreg.body.subject import canonical_subject
from localreg.database.neighbours import Query
from localreg.synthesis.belief import Belief, Limits
from localreg.synthesis.local_fit import LocalFit, kernel_weights, predict, within_reach
from localreg.synthesis.prior import STARTS, Acquisition, Expectation, Prior
from localreg.synthesis.settings import METHODS
from localreg.synthesis.state import State
from localreg.synthesis.synthesizer import Synthesizer

_RATE: Final = 40.0
_WIDE: Final = Limits(np.full(DOF_COUNT, -np.pi), np.full(DOF_COUNT, np.pi), 0.1)


class _Resting(Prior):
    """Expects the pose of the frame before, and a resting one when there is no past."""

    def expect(self, query: Query, state: State) -> Expectation:
        qpos = np.array(state.qpos, dtype=float)
        return Expectation(Belief(qpos, np.zeros(TANGENT_SIZE), np.eye(TANGENT_SIZE), _WIDE))

    def acquire(self, query: Query) -> Acquisition:
        mean, covariance = _regress()
        return Acquisition(np.zeros((STARTS, DOF_COUNT)), mean, np.linalg.inv(covariance))


def stand_in() -> Synthesizer:
    """The estimator."""
    subject = canonical_subject()
    return Synthesizer(subject, _RATE, METHODS["localreg"], chain_of(subject), _Resting())


def _regress() -> tuple[Float[ndarray, "56"], Float[ndarray, "56 56"]]:
    """Regressions of nothing on nothing, of the kinds that rehearsal and frames run."""
    settings = METHODS["localreg"]
    X = np.zeros((settings.neighbours, settings.components), dtype=np.float32)
    Y = np.zeros((settings.neighbours, DOF_COUNT), dtype=np.float32)
    weights = kernel_weights(np.linspace(0.1, 1.0, len(X)))
    share = np.ones(DOF_COUNT)
    held = within_reach(X, weights, X[0])
    LocalFit(X, Y, weights, held, settings.pose_ridge).normal(share)
    return predict(X, Y, weights, X[0], settings.pose_ridge, share, np.eye(DOF_COUNT))
