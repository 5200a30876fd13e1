"""The default prior's frame as machine code: from neighbours and the past to a belief.

Two local regressions, the pose and its step, then a Kalman filter with coloured process noise
that fuses them with the pose before; see `localreg.synthesis.local_regression` for why.
"""

from typing import Final, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Float32
from numba import njit
from numpy import ndarray

from localreg.body.chain import integrate, rotate
from localreg.body.skeleton import QPOS_SIZE, TANGENT_SIZE
from localreg.synthesis.linear_algebra import factorize, positive_inverse, substitute
from localreg.synthesis.local_fit import kernel_weights, predict
from localreg.synthesis.windows import steps_into

_N = TANGENT_SIZE


class Drift(NamedTuple):
    """How the step regression has lately been wrong, in world axes.

    In single precision, like the regressions: it takes half the time.

    Attributes:
        mean: expected error of a step.
        covariance: of that error.
        cross: covariance of the pose with it.
    """

    mean: Float[ndarray, "62"]
    covariance: Float32[ndarray, "62 62"]
    cross: Float32[ndarray, "62 62"]


class Regression(NamedTuple):
    """What does not change from frame to frame of one of the regressions.

    Attributes:
        ridge: of the fit.
        share: of the predicted deviation that is believed, for every output.
        growth: covariance that is added per squared distance of the neighbours.
        floor: deviation that every output has beside.
        usual: squared distance up to which growth was learned.
        strange: variance of every output that is added per squared distance beyond that.
    """

    ridge: float
    share: Float[ndarray, " d"]
    growth: Float[ndarray, "d d"]
    floor: float
    usual: float
    strange: Float[ndarray, " d"]


class Outputs(NamedTuple):
    """What regressions learn from: the database's poses, and steps into them.

    Attributes:
        angles: joint angles of all poses [rad].
        step_root: the root's part of all steps.
        step_angles: joint angles whose differences are the rest [rad].
    """

    angles: Float32[ndarray, "N 56"]
    step_root: Float32[ndarray, "N 6"]
    step_angles: Float32[ndarray, "N 56"]


class Memory(NamedTuple):
    """How the past is carried on.

    Attributes:
        lasts: share of the drift that is still there a frame later.
        floor_position: least deviation of a step's translation [m].
        floor_angle: of its angles [rad].
        pose_information: share of the pose regression's information that counts.
        fading: what all covariances are multiplied by.
    """

    lasts: float
    floor_position: float
    floor_angle: float
    pose_information: float
    fading: float = 1.0


class Ahead(NamedTuple):
    """What is expected of a frame before it is solved; written by `look_ahead`.

    Attributes:
        qpos: the pose to which the past leads.
        covariance: of it, by the past alone.
        drift: as expected.
        gain: change of the drift's mean by the deviation of the pose from the expected one.
        mean: deviation from that pose which past and pose regression expect together.
        information: inverse covariance of that deviation.
    """

    qpos: Float[ndarray, "63"]
    covariance: Float[ndarray, "62 62"]
    drift: Drift
    gain: Float32[ndarray, "62 62"]
    mean: Float[ndarray, "62"]
    information: Float[ndarray, "62 62"]


def blank_drift() -> Drift:
    """Room to write to."""
    return Drift(np.empty(_N), *np.empty((2, _N, _N), np.float32))


def blank_ahead() -> Ahead:
    """Room to write to."""
    covariance, information = np.empty((2, _N, _N))
    gain = np.empty((_N, _N), np.float32)
    return Ahead(np.empty(QPOS_SIZE), covariance, blank_drift(), gain, np.empty(_N), information)


NO_DRIFT: Final = Drift(np.zeros(_N), *np.zeros((2, _N, _N), np.float32))
"""Of which nothing is known; nothing of it lasts, either."""


@njit(cache=True)
@no_type_check
def look_ahead(
    before, covariance, drift, near, distance, pose_inputs, step_inputs,
    pose_regression, step_regression, outputs, memory, ahead,
):  # fmt: skip
    """From the last pose and the neighbours to what is expected.

    Args:
        before: the last pose.
        covariance: of its tangent coordinates.
        drift: as last corrected.
        near: the neighbours.
        distance: how far they are, squared, as if the whole query were known.
        pose_inputs: reduced inputs of the neighbours and of the query.
        step_inputs: the same for the step.
        pose_regression: what is known of it beforehand.
        step_regression: the same for the step.
        outputs: of both.
        memory: how the past is carried on.
        ahead: written.
    """
    weights = kernel_weights(near.squared_distances)
    moves = steps_into(outputs.step_root, outputs.step_angles, near.rows)
    step, doubt = regress(step_inputs, moves, weights, step_regression, distance)
    to_the_world(before[3:7], step, doubt)
    _carry(covariance, drift, doubt, memory, ahead)
    integrate(before, step + ahead.drift.mean, ahead.qpos)
    poses = _rows_of(outputs.angles, near.rows)
    pose, doubt = regress(pose_inputs, poses, weights, pose_regression, distance)
    _fuse(pose, doubt, memory.pose_information / memory.fading, ahead)


@njit(cache=True)
@no_type_check
def _rows_of(table, rows):
    out = np.empty((len(rows), table.shape[1]), table.dtype)
    for i in range(len(rows)):
        row = rows[i]
        for j in range(table.shape[1]):
            out[i, j] = table[row, j]
    return out


@njit(cache=True)
@no_type_check
def regress(inputs, outputs, weights, regression, distance):
    """Mean and covariance by one regression."""
    X, x = inputs
    mean, known = predict(X, outputs, weights, x, regression.ridge, regression.share)
    growth, beyond = regression.growth, max(0.0, distance - regression.usual)
    for i in range(len(known)):
        for j in range(len(known)):
            known[i, j] += distance * growth[i, j]
        known[i, i] += regression.floor**2 + beyond * regression.strange[i]
    return mean, known


@njit(cache=True)
@no_type_check
def to_the_world(quaternion, mean, covariance):
    """Turn a step's root translation from the root's axes into the world's, in place."""
    turned = np.empty(3)
    rotate(quaternion, mean[:3], turned)
    mean[:3] = turned
    for j in range(covariance.shape[1]):
        rotate(quaternion, covariance[:3, j], turned)
        covariance[:3, j] = turned
    for i in range(len(covariance)):
        rotate(quaternion, covariance[i, :3], turned)
        covariance[i, :3] = turned


@njit(cache=True)
@no_type_check
def _carry(covariance, drift, step, memory, ahead):
    """Carry the past on: covariance of the pose, and the drift."""
    n, lasts, fading = len(covariance), memory.lasts, memory.fading
    before, crossed = drift.covariance, drift.cross
    expected, spread, cross = ahead.covariance, ahead.drift.covariance, ahead.drift.cross
    for i in range(n):
        ahead.drift.mean[i] = lasts * drift.mean[i]
        for j in range(n):
            spread[i, j] = fading * (lasts**2 * before[i, j] + (1.0 - lasts**2) * step[i, j])
            cross[i, j] = fading * lasts * crossed[i, j] + spread[i, j]
            both = lasts * (crossed[i, j] + crossed[j, i])
            expected[i, j] = fading * (covariance[i, j] + both) + spread[i, j]
        floor = memory.floor_position if i < 3 else memory.floor_angle
        expected[i, i] += fading * floor**2


@njit(cache=True)
@no_type_check
def _fuse(pose, doubt, share, ahead):
    """What past and pose regression say together, and the gain of the drift."""
    information, mean = ahead.information, ahead.mean
    carried, new = positive_inverse(ahead.covariance), positive_inverse(doubt)
    information[:] = carried
    pull = np.zeros(len(carried))
    for i in range(len(new)):
        for j in range(len(new)):
            told = 0.5 * share * (new[i, j] + new[j, i])
            information[6 + i, 6 + j] += told
            pull[6 + i] += told * (pose[j] - ahead.qpos[7 + j])
    L = np.zeros_like(information)
    if factorize(information, 0.0, L):
        substitute(L, pull, mean)
    else:
        mean[:] = np.nan
    np.dot(ahead.drift.cross.T, carried.astype(np.float32), ahead.gain)


@njit(cache=True)
@no_type_check
def correct(ahead, moved, after, drift):
    """Write the drift once the pose is known better.

    Args:
        ahead: what was expected.
        moved: deviation of the pose from it.
        after: covariance of the pose.
        drift: written.

    Returns:
        Whether it is made of numbers.
    """
    gain = ahead.gain
    mean, spread, cross = drift.mean, drift.covariance, drift.cross
    mean[:] = ahead.drift.mean + np.dot(gain, moved.astype(np.float32))
    np.dot(after.astype(np.float32), gain.T, cross)
    less = np.dot(gain, ahead.drift.cross - cross)
    before, total = ahead.drift.covariance, np.sum(mean)
    for i in range(len(spread)):
        for j in range(len(spread)):
            spread[i, j] = before[i, j] - np.float32(0.5) * (less[i, j] + less[j, i])
            total += spread[i, j] + cross[i, j]
    return np.isfinite(total)
