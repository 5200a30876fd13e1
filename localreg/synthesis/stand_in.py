"""An estimator without a database, for whoever wants the code of frames compiled early.

What it runs, it runs with the types of the default method: attention, regression, solver. What
is missing takes about as long, so two processes can compile at once: what needs a database
(features, search, rehearsal), and `look_ahead_once`.
"""

from typing import Final

import numpy as np

from localreg.body.chain import chain_of
from localreg.body.skeleton import DOF_COUNT, QPOS_SIZE, TANGENT_SIZE
from localreg.body.subject import canonical_subject
from localreg.database.block_search import plain
from localreg.database.neighbours import Neighbours, Query
from localreg.synthesis.belief import Belief, Limits
from localreg.synthesis.local_fit import LocalFit, kernel_weights, within_reach
from localreg.synthesis.look_ahead import (
    NO_DRIFT,
    Memory,
    Outputs,
    Regression,
    blank_ahead,
    blank_drift,
    correct,
    look_ahead,
    regress,
)
from localreg.synthesis.prior import STARTS, Acquisition, Expectation, Prior
from localreg.synthesis.settings import METHODS
from localreg.synthesis.state import State
from localreg.synthesis.synthesizer import Synthesizer
from localreg.synthesis.windows import Reduced

_RATE: Final = 40.0
_SETTINGS: Final = METHODS["localreg"]
_NEAR: Final = Neighbours(
    np.ones(_SETTINGS.neighbours, dtype=np.int64), np.linspace(0.1, 1.0, _SETTINGS.neighbours)
)
_INPUTS: Final = Reduced(
    np.zeros((_SETTINGS.neighbours, _SETTINGS.components), dtype=np.float32),
    np.zeros(_SETTINGS.components, dtype=np.float32),
)
_WIDE: Final = Limits(np.full(DOF_COUNT, -np.pi), np.full(DOF_COUNT, np.pi), 0.1)


class _Resting(Prior):
    """Expects the pose of the frame before, and a resting one when there is no past."""

    def expect(self, query: Query, state: State) -> Expectation:
        qpos = np.array(state.qpos, dtype=float)
        return Expectation(Belief(qpos, np.zeros(TANGENT_SIZE), np.eye(TANGENT_SIZE), _WIDE))

    def acquire(self, query: Query) -> Acquisition:
        Y = np.zeros((len(_INPUTS.examples), DOF_COUNT), dtype=np.float32)
        weights = kernel_weights(_NEAR.squared_distances)
        LocalFit(
            _INPUTS.examples, Y, weights,
            within_reach(_INPUTS.examples, weights, _INPUTS.query), _SETTINGS.pose_ridge,
        ).normal(np.ones(DOF_COUNT))  # fmt: skip
        mean, covariance = regress(_INPUTS, Y, weights, _regression(DOF_COUNT), 1.0)
        return Acquisition(np.zeros((STARTS, DOF_COUNT)), mean, np.linalg.inv(covariance))


def stand_in() -> Synthesizer:
    """The estimator."""
    subject = canonical_subject()
    return Synthesizer(subject, _RATE, _SETTINGS, chain_of(subject), _Resting())


def look_ahead_once() -> None:
    """Regressions of nothing on nothing, what follows from them, and its correction."""
    nothing = np.zeros((2, DOF_COUNT), dtype=np.float32)
    outputs = Outputs(*map(plain, (nothing, nothing[:, :6].copy(), nothing)))
    memory, ahead = Memory(0.0, 1e-3, 1e-3, 1.0), blank_ahead()
    qpos, covariance = np.zeros(QPOS_SIZE), np.eye(TANGENT_SIZE)
    qpos[3] = 1.0
    look_ahead(
        qpos, covariance, NO_DRIFT, _NEAR, 1.0, _INPUTS, _INPUTS, _regression(DOF_COUNT),
        _regression(TANGENT_SIZE), outputs, memory, ahead,
    )  # fmt: skip
    correct(ahead, np.zeros(TANGENT_SIZE), covariance, blank_drift())


def _regression(size: int) -> Regression:
    return Regression(1.0, np.ones(size), np.eye(size), 0.0, 1.0, np.zeros(size))
