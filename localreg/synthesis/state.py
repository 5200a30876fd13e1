"""What an estimator carries from frame to frame."""

from typing import Any, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float
from numba import njit
from numpy import ndarray

from localreg.body.chain import difference, integrate
from localreg.body.skeleton import DOF_COUNT, QPOS_SIZE, TANGENT_SIZE
from localreg.database.neighbours import Neighbours
from localreg.synthesis.attention import LONG, Attention
from localreg.synthesis.observation import Signals
from localreg.synthesis.rival import Doubt
from localreg.synthesis.strain import Strain


class State(NamedTuple):
    """The belief after a frame; inside a traced prior its arrays are JAX's.

    Attributes:
        qpos: the pose.
        covariance: of the pose's 62 tangent coordinates.
        velocity: last step of the root: translation [m], rotation vector [rad] a frame.
        history: joint angles of the last m poses, newest first [rad].
        history_valid: which of them exist.
        attention: which trackers are being heard.
        drift: how the past has lately misled; the prior's own business.
        near: the neighbours in the database.
        strain: how far trackers keep being left.
        lost: frames in a row that the trackers were left far from.
        signals: what the trackers measured when something was first measured.
        doubt: whether another pose would explain the trackers better.
    """

    qpos: Float[ndarray, "63"]
    covariance: Float[ndarray, "62 62"]
    velocity: Float[ndarray, "6"]
    history: Float[ndarray, "m 56"]
    history_valid: Bool[ndarray, " m"]
    attention: Attention
    strain: Strain
    drift: Any = None
    near: Neighbours | None = None
    lost: int = 0
    signals: Signals | None = None
    doubt: Doubt = Doubt()


def blank_state(history: int, trackers: int) -> State:
    """A state that knows nothing: upright at the origin, no past."""
    qpos = np.zeros(QPOS_SIZE)
    qpos[2], qpos[3:5] = 0.95, 0.5**0.5
    return State(
        qpos=qpos,
        covariance=100.0 * np.eye(TANGENT_SIZE),
        velocity=np.zeros(6),
        history=np.zeros((history, DOF_COUNT)),
        history_valid=np.zeros(history, dtype=bool),
        attention=Attention(np.full(trackers, LONG), LONG),
        strain=Strain.none(trackers),
    )


def state_at(qpos: Float[ndarray, "63"], history: int, trackers: int) -> State:
    """A state that knows one pose well and nothing of before."""
    state = blank_state(history, trackers)
    past = np.repeat(qpos[None, 7:], history, axis=0)
    valid = np.zeros(history, dtype=bool)
    valid[0] = True
    return state._replace(
        attention=Attention(np.zeros(trackers, dtype=int), 0),
        qpos=qpos,
        covariance=1e-4 * np.eye(TANGENT_SIZE),
        history=past,
        history_valid=valid,
    )


def remember(state: State, qpos: Float[ndarray, "63"]) -> State:
    """The state with a solved pose in front of its history, the oldest dropped."""
    history, valid = np.asarray(state.history), np.asarray(state.history_valid)
    velocity, later, later_valid = np.empty(6), np.empty_like(history), np.empty_like(valid)
    before = np.asarray(state.qpos, dtype=float)
    _remember(before, qpos, history, valid, velocity, later, later_valid)
    return state._replace(qpos=qpos, velocity=velocity, history=later, history_valid=later_valid)


@njit(cache=True)
@no_type_check
def _remember(before, qpos, history, valid, velocity, later, later_valid):
    step = np.empty(TANGENT_SIZE)
    difference(before, qpos, step)
    velocity[:] = step[:6]
    later[0], later[1:] = qpos[7:], history[:-1]
    later_valid[0], later_valid[1:] = True, valid[:-1]


@njit(cache=True)
@no_type_check
def coast(qpos, velocity, history, valid, ahead):
    """Write where the pose would be with the velocity of the last step."""
    step = np.zeros(TANGENT_SIZE)
    step[:6] = velocity
    if np.all(valid[:2]):
        step[6:] = history[0] - history[1]
    integrate(qpos, step, ahead)
